# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The drivers of examples/ publish what their device says, and the estimator takes it."""

import os
from pathlib import Path
import shutil
import subprocess
import sys

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.serialization import serialize_message  # noqa: E402
from sensor_msgs.msg import Imu, PointCloud2  # noqa: E402

from instruments import TAN2018, TOP  # noqa: E402
from peer import PATIENCE_S  # noqa: E402
from starcal_ros.messages import cdr_imu, cdr_pointcloud  # noqa: E402
from starcal_ros.messages.cdr import Messages  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402

SOURCE = TOP / 'examples' / 'driver_cpp'
SCENARIO = TAN2018.replace({'simulation.duration_s': 5.0, 'gyro.rate_hz': 20.0})


def lines(gyro, frames):
    """Return what the device would say."""
    said = [(stamp_ns, f'gyro {stamp_ns} ' + ' '.join(map(repr, rate)))
            for stamp_ns, rate in zip(gyro.stamp_ns.tolist(), gyro.rate.tolist())]
    for k, stamp_ns in enumerate(frames.stamp_ns.tolist()):
        stars = slice(frames.first[k], frames.first[k + 1])
        said.append((stamp_ns, f'stars {stamp_ns} ' + ' '.join(
            f'{u!r} {v!r} {hip} {sigma!r} {magnitude!r}' for (u, v), hip, sigma, magnitude in zip(
                frames.uv_raster[stars].tolist(), frames.catalog_id[stars].tolist(),
                frames.sigma[stars].tolist(), frames.magnitude[stars].tolist()))))
    return [line for _, line in sorted(said)]


@pytest.fixture(scope='module')
def compiled(tmp_path_factory):
    """Return the driver in C++, where the libraries of ROS 2 for C++ are."""
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    if not any((Path(prefix) / 'share' / 'rclcpp' / 'cmake').is_dir() for prefix in prefixes):
        pytest.skip('rclcpp is not installed: the driver in C++ can not be compiled')
    if not shutil.which('cmake'):
        pytest.skip('cmake is not installed: the driver in C++ can not be compiled')
    folder = tmp_path_factory.mktemp('driver')
    for words in (['-S', SOURCE, '-B', folder], ['--build', folder]):
        done = subprocess.run(['cmake', *words], text=True, capture_output=True)
        assert done.returncode == 0, done.stdout + done.stderr
        assert 'warning' not in done.stderr.lower(), done.stderr
    return folder / 'driver'


@pytest.fixture(params=['python', 'c++'])
def driver(request):
    """Return the command of a driver."""
    if request.param == 'python':
        return [sys.executable, TOP / 'examples' / 'driver.py']
    return [request.getfixturevalue('compiled')]


def test_driver_publishes_what_its_device_says_to_the_bit(driver, peer):
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    readings, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    imus, clouds = peer.listen(Imu, 'imu/data_raw'), peer.listen(
        PointCloud2, 'star_tracker/centroids')
    with subprocess.Popen(driver, stdin=subprocess.PIPE, stderr=subprocess.PIPE,
                          text=True) as process:
        def say(*said):
            process.stdin.write('\n'.join([*said, '']))
            process.stdin.flush()

        try:
            # What is said before both sides have met is lost: the same until it is heard.
            peer.until(lambda: imus and clouds or say('gyro 1 0.0 0.0 0.0', 'stars 1'))
            say('gyro 2 0.0 0.0 0.0', 'stars 2')
            peer.until(lambda: all(each[-1].header.stamp.nanosec == 2 for each in (imus, clouds)))
            imus.clear()
            clouds.clear()
            said = ['gyro x y', 'nonsense 1 2 3', *lines(readings, frames),
                    f'stars {frames.stamp_ns[-1] + 1}']
            for k in range(0, len(said), 20):           # as a device would, in pieces
                say(*said[k:k + 20])
                rclpy.spin_once(peer.node, timeout_sec=0.05)
            process.stdin.close()
            peer.until(lambda: len(imus) == len(readings) and len(clouds) == len(frames) + 1)
            assert process.wait(PATIENCE_S) == 0
            assert 'passed over' in process.stderr.read()
        finally:
            process.kill()
    got = cdr_imu.decode_imu(Messages.join([serialize_message(each) for each in imus]))
    np.testing.assert_array_equal(got.stamp_ns, readings.stamp_ns)
    np.testing.assert_array_equal(got.rate, readings.rate)
    got = cdr_pointcloud.decode_centroids(
        Messages.join([serialize_message(each) for each in clouds]))
    np.testing.assert_array_equal(got.first, [*frames.first, frames.first[-1]])
    np.testing.assert_array_equal(got.stamp_ns[:-1], frames.stamp_ns)
    np.testing.assert_array_equal(got.uv_raster, frames.uv_raster)
    np.testing.assert_array_equal(got.catalog_id, frames.catalog_id)
    np.testing.assert_allclose(got.sigma, frames.sigma, rtol=1e-7)
    np.testing.assert_allclose(got.magnitude, frames.magnitude, rtol=1e-6)
    assert {each.header.frame_id for each in imus} == {'gyro'}
    assert {each.header.frame_id for each in clouds} == {'star_tracker_optical'}
    assert all(each.orientation_covariance[0] == -1.0 for each in imus)


def test_estimator_takes_what_the_driver_publishes(start, peer):
    start('estimator')
    peer.until(lambda: peer.node.count_publishers('starcal/state') == 1)
    run = SCENARIO.replace({'gyro.rate_hz': 100.0})
    gyro, tracker = sensors.gyro(run), sensors.star_tracker(run)
    said = lines(gyro.next(gyro.count), tracker.next(tracker.count))
    with subprocess.Popen([sys.executable, TOP / 'examples' / 'driver.py'],
                          stdin=subprocess.PIPE, text=True) as process:
        try:
            peer.until(lambda: peer.node.count_publishers('imu/data_raw') == 2)
            # As a device would, in pieces.
            for k in range(0, len(said), 50):
                process.stdin.write('\n'.join([*said[k:k + 50], '']))
                process.stdin.flush()
                rclpy.spin_once(peer.node, timeout_sec=0.05)
            peer.until(lambda: len(peer.states) >= 8)
        finally:
            process.kill()
