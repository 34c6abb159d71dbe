# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The node `intrinsics_estimator` gives live what ``starcal intrinsics`` gives of a recording."""

from dataclasses import replace
import signal

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from sensor_msgs.msg import CameraInfo, PointCloud2  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402

from instruments import TAN2018  # noqa: E402
from peer import LATCHED, PATIENCE_S, Peer  # noqa: E402
from starcal_ros import calibration  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.config.models import detector  # noqa: E402
from starcal_ros.measurements.samples import GyroSamples  # noqa: E402
from starcal_ros.messages.conventions import from_camera_info  # noqa: E402
from starcal_ros.nodes import intrinsics_diagnostics  # noqa: E402
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
    diagnostics = peer.listen(DiagnosticArray, 'diagnostics', 100)
    peer.until(lambda: peer.frames.get_subscription_count() and peer.node.count_publishers(
        'starcal/intrinsics/state'))
    frames = sensors.star_tracker(SCENARIO).next(200)
    peer.frames.publish(PointCloud2(width=1, height=1, point_step=4, data=bytes(4)))
    peer.send(GyroSamples.empty(), frames)
    last_s = frames.stamp_ns[-1] * 1e-9
    peer.until(lambda: states and states[-1].data[0] >= last_s - 1e-6)
    peer.until(lambda: len(diagnostics) >= len(states))
    process.send_signal(signal.SIGINT)
    errors = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 0 and 'message dropped' in errors
    method = calibration.start(SCENARIO)
    method.add_frames(frames)
    expected = method.estimate()
    np.testing.assert_allclose(states[-1].data[1:8], expected.intrinsics, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(np.reshape(states[-1].data[8:], (7, 7)), expected.covariance,
                               rtol=1e-6, atol=1e-22)
    status = diagnostics[-1].status[0]
    values = {item.key: item.value for item in status.values}
    judged = method.judge(expected, 3000)
    assert status.name == 'starcal: intrinsics' and status.message == judged.summary
    assert status.level == DiagnosticStatus.OK and values['verdict'] == judged.word == 'not yet'
    for each in judged.consistency.statistics:
        key = each.name.lower().replace(' ', '_')
        assert float(values[key]) == pytest.approx(each.value, rel=1e-3, abs=1e-6)
        assert float(values[f'{key}_high']) == pytest.approx(each.high, rel=1e-5)
    assert float(values['tolerance_f_mm']) == 2e-4 and float(values['variance_factor_k1']) == 1.0
    info = cameras[-1]
    assert info.header.frame_id == 'star_tracker_intrinsics_optical'
    np.testing.assert_allclose(
        from_camera_info(info.k, np.array(info.d), detector(SCENARIO.camera)),
        expected.intrinsics, rtol=1e-9, atol=1e-12)


def test_data_that_contradict_the_camera_are_an_error(context):
    node = rclpy.create_node('judge', namespace='one')
    frames = sensors.star_tracker(SCENARIO).next(60)
    method = calibration.start(SCENARIO)
    method.add_frames(replace(frames, uv_raster=frames.uv_raster + 0.05 * np.sin(
        2.0 * np.pi * frames.uv_raster)))
    estimate = method.estimate()
    status = intrinsics_diagnostics.message(node, estimate, method.judge(estimate)).status[0]
    assert status.level == DiagnosticStatus.ERROR and status.name == 'one/starcal: intrinsics'
    assert status.message.startswith('inconsistent: ') and 'mean over the pixel' in status.message
    assert intrinsics_diagnostics.message(node, None, None).status[0].level == (
        DiagnosticStatus.WARN)
    node.destroy_node()


def test_unknown_method_is_named(start):
    process = start('intrinsics_estimator', '-p', 'intrinsics.method:=guess')
    errors = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 2
    assert "got 'guess', allowed are angular_distance" in errors and 'Traceback' not in errors
