# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages have the same contents, whether of rclpy's classes or of those of recordings."""


import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402

from starcal_ros.core import rotation  # noqa: E402
from starcal_ros.core.camera import Detector  # noqa: E402
from starcal_ros.core.camera_estimate import CameraEstimate  # noqa: E402
from starcal_ros.filter.attitude_track import AttitudeTrack  # noqa: E402
from starcal_ros.messages import cdr_imu, topics  # noqa: E402
from starcal_ros.messages.conventions import INERTIAL_FRAME  # noqa: E402
from starcal_ros.messages.drawings import LINE_LIST, TEXT, Drawings  # noqa: E402
from starcal_ros.nodes.base.qos import message_type  # noqa: E402
from starcal_ros.nodes.base.ros_messages import DRAWINGS as LIVE  # noqa: E402
from starcal_ros.recording.writer import TYPES, serialize, typestore  # noqa: E402

RECORDED = Drawings(TYPES)
STAMP_NS = 1_782_993_600_123_456_789
RNG = np.random.default_rng(5)
SIGMAS = RNG.standard_normal((16, 16))
CAMERA = np.array([3.2, -4.1, 50.0, 1e-4, 2e-7, -3e-6, 4e-6])


def plain(type_name, cdr):
    """Return CDR with the bytes between its fields zero, which the middleware leaves as found."""
    return serialize(type_name, typestore().deserialize_cdr(cdr, type_name))


@pytest.mark.parametrize('type_name, make', [
    (topics.CAMERA.type_name,
     lambda c: c.camera_info(STAMP_NS, CAMERA, Detector(1024, 768, 0.015), 'o')),
    (topics.TRUE_PARAMETERS.type_name, lambda c: c.labelled([('a', 2), ('b', 5)], CAMERA)),
    (topics.INTRINSICS_STATE.type_name, lambda c: c.intrinsics(
        STAMP_NS, CameraEstimate(CAMERA, SIGMAS[:7, :7], 3, 30))),
    (topics.MARKERS.type_name, lambda c: c.marker_array([
        c.marker(STAMP_NS, 'o', 'lines', LINE_LIST, SIGMAS[:4, :3], [(0.1, 0.2, 0.3)] * 4, 0.1),
        c.marker(STAMP_NS, 'o', 'text', TEXT, SIGMAS[:1, :3], [(0.1, 0.2, 0.3)], 0.1, '×')])),
])
def test_live_and_recorded_messages_are_the_same_bytes(type_name, make):
    recorded = serialize(type_name, make(RECORDED))
    assert plain(type_name, serialize_message(make(LIVE))) == recorded


def test_attitudes_are_read_as_they_were_written():
    n = 3
    roots = RNG.standard_normal((n, 3, 3))
    track = AttitudeTrack(STAMP_NS + np.arange(n), rotation.exp(RNG.standard_normal((n, 3))),
                          roots @ np.swapaxes(roots, 1, 2), RNG.standard_normal((n, 3)))
    for k, row in enumerate(cdr_imu.encode_attitudes(track, SIGMAS[:3, :3])):
        message = deserialize_message(row.tobytes(), message_type(topics.ATTITUDE.type_name))
        assert plain(topics.ATTITUDE.type_name, serialize_message(message)) == row.tobytes()
        stamp, q, rate = message.header.stamp, message.orientation, message.angular_velocity
        assert (stamp.sec * 10**9 + stamp.nanosec, message.header.frame_id) == (
            track.stamp_ns[k], 'gyro')
        np.testing.assert_allclose(rotation.to_matrix(np.array([q.x, q.y, q.z, q.w])),
                                   track.C_gi[k].T, atol=1e-12)
        np.testing.assert_array_equal([rate.x, rate.y, rate.z], track.rate[k])
        np.testing.assert_array_equal(message.orientation_covariance, track.covariance[k].ravel())
        np.testing.assert_array_equal(message.angular_velocity_covariance, SIGMAS[:3, :3].ravel())
        assert message.linear_acceleration_covariance.tolist() == [-1.0] + 8 * [0.0]


def test_no_attitude_is_no_message():
    assert not len(cdr_imu.encode_attitudes(AttitudeTrack.empty(), np.eye(3)))


def test_orientations_are_read_as_they_were_written():
    many, stamps = rotation.exp(RNG.standard_normal((4, 3))), STAMP_NS + 10**8 * np.arange(4)
    kind = message_type(topics.TRUE_ATTITUDE.type_name)
    rows = cdr_imu.encode_quaternions(stamps, many, INERTIAL_FRAME)
    for row, stamp_ns, each in zip(rows, stamps.tolist(), many):
        message = deserialize_message(row.tobytes(), kind)
        assert plain(topics.TRUE_ATTITUDE.type_name, row.tobytes()) == row.tobytes()
        stamp, q = message.header.stamp, message.quaternion
        assert (stamp.sec * 10**9 + stamp.nanosec, message.header.frame_id) == (stamp_ns, 'icrf')
        np.testing.assert_allclose(rotation.to_matrix(np.array([q.x, q.y, q.z, q.w])), each,
                                   atol=1e-12)
