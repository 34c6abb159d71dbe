# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the estimator says of a frame is read as it was written, by rclpy and by rosbags."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from rclpy.serialization import deserialize_message  # noqa: E402

from instruments import TAN2018  # noqa: E402
from starcal_ros.core import rotation  # noqa: E402
from starcal_ros.core.camera import Detector  # noqa: E402
from starcal_ros.filter.calibrator import Calibrator  # noqa: E402
from starcal_ros.messages import cdr_results, conventions, topics  # noqa: E402
from starcal_ros.nodes.base.qos import message_type  # noqa: E402
from starcal_ros.recording.writer import serialize, typestore  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402

SCENARIO = TAN2018.replace({'simulation.duration_s': 20.0})
STAMP_NS = 1_782_993_600_123_456_789
RNG = np.random.default_rng(5)
C_SG = rotation.exp(RNG.standard_normal(3))
ROOT = RNG.standard_normal((16, 16))
COVARIANCE = ROOT @ ROOT.T
CAMERA = np.array([3.2, -4.1, 50.0, 1e-4, 2e-7, -3e-6, 4e-6])
DETECTOR = Detector(1024, 768, 0.015)
TF = topics.TRANSFORM.type_name


@pytest.fixture(scope='module')
def frame():
    """Return what the last frame of a run gave, one of its stars without a place."""
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    frames = tracker.next(tracker.count)
    frames.catalog_id[-1] = 0
    calibrator = Calibrator(SCENARIO)
    calibrator.add_gyro(gyro.next(gyro.count))
    calibrator.add_frames(frames)
    *_, last = calibrator.process()
    assert 0 < np.isfinite(last.chi2).sum() < len(last.chi2)
    return last


def read(topic, message):
    """Return a message in rclpy's class, written as rosbags writes it."""
    of_rosbags = typestore().deserialize_cdr(message, topic.type_name)
    assert serialize(topic.type_name, of_rosbags) == message
    return deserialize_message(message, message_type(topic.type_name))


def stamped(message, frame_id, stamp_ns=STAMP_NS):
    stamp = message.header.stamp
    return (stamp.sec * 10**9 + stamp.nanosec, message.header.frame_id) == (stamp_ns, frame_id)


def matrix(q):
    return rotation.to_matrix(np.array([q.x, q.y, q.z, q.w]))


def test_state(frame):
    message = read(topics.STATE, cdr_results.encode_state(STAMP_NS, frame.belief))
    assert [(part.label, part.size) for part in message.layout.dim] == [
        *conventions.STATE_LAYOUT]
    np.testing.assert_array_equal(message.data, conventions.state_vector(STAMP_NS, frame.belief))


def test_camera():
    message = read(topics.CAMERA, cdr_results.encode_camera(STAMP_NS, CAMERA, DETECTOR))
    assert stamped(message, conventions.CALIBRATED_FRAME)
    assert (message.width, message.height, message.distortion_model) == (1024, 768, 'plumb_bob')
    values = conventions.camera_info(CAMERA, DETECTOR)
    assert [*map(list, (message.d, message.k, message.p))] == [values.D, values.K, values.P]
    np.testing.assert_array_equal(message.r, np.eye(3).ravel())


def test_bias():
    message = read(topics.GYRO_BIAS, cdr_results.encode_bias(STAMP_NS, CAMERA[:3], COVARIANCE))
    rate, spread = message.twist.twist.angular, message.twist.covariance.reshape(6, 6)
    assert stamped(message, 'gyro') and [rate.x, rate.y, rate.z] == CAMERA[:3].tolist()
    np.testing.assert_array_equal(spread[3:, 3:], COVARIANCE[3:6, 3:6])
    assert not spread[:3].any() and not spread[:, :3].any()


def test_mounting():
    message = read(topics.MOUNTING, cdr_results.encode_mounting(STAMP_NS, C_SG, COVARIANCE))
    assert stamped(message, 'gyro')
    np.testing.assert_allclose(conventions.mounting_from_optical(
        matrix(message.pose.pose.orientation)), C_SG, atol=1e-12)
    np.testing.assert_array_equal(message.pose.covariance.reshape(6, 6),
                                  conventions.mounting_covariance(C_SG, COVARIANCE))


def test_residuals_leave_out_stars_without_a_place(frame):
    message = read(topics.RESIDUALS, cdr_results.encode_residuals(frame))
    assert stamped(message, 'star_tracker_optical', frame.stamp_ns)
    known = np.isfinite(frame.chi2)
    assert (message.height, message.width) == (1, known.sum())
    assert len(message.data) == message.row_step == message.width * message.point_step
    kinds = {2: 'u1', 6: '<u4', 7: '<f4', 8: '<f8'}
    points = np.frombuffer(bytes(message.data), np.dtype({
        'names': [field.name for field in message.fields],
        'formats': [kinds[field.datatype] for field in message.fields],
        'offsets': [field.offset for field in message.fields], 'itemsize': message.point_step}))
    np.testing.assert_array_equal(points['u'], frame.uv_raster[known, 0])
    np.testing.assert_array_equal(points['dv'], frame.residual[known, 1])
    np.testing.assert_array_equal(points['catalog_id'], frame.catalog_id[known])
    np.testing.assert_array_equal(points['nis'], frame.chi2[known].astype('f4'))
    np.testing.assert_array_equal(points['accepted'], frame.accepted[known])


def test_frames_are_a_tree_and_the_calibrated_camera_is_where_the_star_tracker_is():
    message = cdr_results.encode_transforms(STAMP_NS, C_SG)
    transforms = typestore().deserialize_cdr(message, TF).transforms
    assert serialize(TF, typestore().types[TF](transforms)) == message
    assert all(stamped(each, each.header.frame_id) for each in transforms)
    parents = {each.child_frame_id: each.header.frame_id for each in transforms}
    assert parents == {'star_tracker_optical': 'gyro',
                       'star_tracker_calibrated_optical': 'star_tracker_optical'}
    assert len(parents) == len(transforms)
    np.testing.assert_allclose(matrix(transforms[0].transform.rotation),
                               conventions.optical_in_gyro(C_SG), atol=1e-12)
    q = transforms[1].transform.rotation
    assert (q.x, q.y, q.z, q.w) == (0.0, 0.0, 0.0, 1.0)
