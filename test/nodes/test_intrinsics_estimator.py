# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The node `intrinsics_estimator` gives live what ``starcal intrinsics`` gives of a recording."""

import signal

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from sensor_msgs.msg import CameraInfo, PointCloud2  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402

from instruments import TAN2018  # noqa: E402
from peer import LATCHED, PATIENCE_S, Peer  # noqa: E402
from starcal_ros import calibration  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.config.models import detector  # noqa: E402
from starcal_ros.measurements.samples import GyroSamples  # noqa: E402
from starcal_ros.messages.conventions import from_camera_info  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402

SCENARIO = TAN2018.replace({
    'simulation.duration_s': 100.0, 'intrinsics.method': 'angular_distance'})


@pytest.fixture
def context():
    rclpy.init()
    yield
    rclpy.shutdown()


def test_camera_live_is_that_of_the_same_frames_offline(start, context, tmp_path):
    (tmp_path / 'config.yaml').write_text(parameter_file.dump(SCENARIO))
    process = start('intrinsics_estimator', '--params-file', str(tmp_path / 'config.yaml'))
    peer = Peer()
    cameras = peer.listen(CameraInfo, 'starcal/intrinsics/camera_info', LATCHED)
    states = peer.listen(Float64MultiArray, 'starcal/intrinsics/state', LATCHED)
    peer.until(lambda: peer.frames.get_subscription_count() and peer.node.count_publishers(
        'starcal/intrinsics/state'))
    frames = sensors.star_tracker(SCENARIO).next(200)
    peer.frames.publish(PointCloud2(width=1, height=1, point_step=4, data=bytes(4)))
    peer.send(GyroSamples.empty(), frames)
    last_s = frames.stamp_ns[-1] * 1e-9
    peer.until(lambda: states and states[-1].data[0] >= last_s - 1e-6)
    process.send_signal(signal.SIGINT)
    errors = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 0 and 'message dropped' in errors
    method = calibration.start(SCENARIO)
    method.add_frames(frames)
    expected = method.estimate()
    np.testing.assert_allclose(states[-1].data[1:8], expected.intrinsics, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(np.reshape(states[-1].data[8:], (7, 7)), expected.covariance,
                               rtol=1e-6, atol=1e-22)
    info = cameras[-1]
    assert info.header.frame_id == 'star_tracker_optical'
    np.testing.assert_allclose(
        from_camera_info(info.k, np.array(info.d), detector(SCENARIO.camera)),
        expected.intrinsics, rtol=1e-9, atol=1e-12)


def test_unknown_method_is_named(start):
    process = start('intrinsics_estimator', '-p', 'intrinsics.method:=guess')
    errors = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 2
    assert "got 'guess', allowed are angular_distance" in errors and 'Traceback' not in errors
