# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A backlog goes out in the rhythm of the readings, at real time."""

import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from rclpy.qos import QoSProfile  # noqa: E402
from sensor_msgs.msg import Imu  # noqa: E402

from instruments import TAN2018  # noqa: E402
from starcal_ros.config import parameter_file  # noqa: E402
from starcal_ros.messages import cdr_imu, cdr_pointcloud  # noqa: E402
from starcal_ros.nodes.base import rhythm as rhythm_module  # noqa: E402
from starcal_ros.nodes.base.rhythm import BURST, CATCH_UP, PATIENCE_S, Rhythm  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402

RATE_HZ = 100.0


class Clock:
    """Time that passes when it is told to."""

    def __init__(self):
        self.now_s = 1000.0

    def monotonic(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(rhythm_module, 'time', clock)
    return clock


def run(clock, rhythm, batches, factor):
    """Hear batches of readings in time, and return when each message goes out [s]."""
    sent_s, first, began_s = [], 0, clock.now_s
    for size in batches:
        last = first + size
        clock.now_s = max(clock.now_s, began_s + last / RATE_HZ / factor)
        rhythm.heard(np.arange(first + 1, last + 1) * 10**7)
        sent_s += [clock.now_s for _ in rhythm.spread(range(size))]
        first = last
    return np.array(sent_s)


@pytest.mark.parametrize('held_up', [20, 100, 450])
def test_a_backlog_of_a_run_at_real_time_is_spread(clock, held_up):
    """No eleven go out in the time in which a queue of ten empties at four times the rate."""
    sent_s = run(clock, Rhythm(RATE_HZ), [1] * 50 + [held_up] + [1] * 2000, 1.0)
    for n in (10, 50):
        assert (sent_s[n:] - sent_s[:-n]).min() >= (n - BURST) / (CATCH_UP * RATE_HZ) - 1e-9
    assert sent_s[-1] == pytest.approx(1000.0 + len(sent_s) / RATE_HZ, abs=1e-6)   # caught up


def test_a_reading_that_comes_in_time_does_not_wait(clock):
    sent_s = run(clock, Rhythm(RATE_HZ), [1] * 1000, 1.0)
    np.testing.assert_allclose(sent_s, 1000.0 + np.arange(1, 1001) / RATE_HZ, rtol=1e-12)


@pytest.mark.parametrize('factor', [2.0, 10.0, 100.0])
def test_a_faster_run_is_held_up_for_a_moment_at_most(clock, factor):
    sent_s = run(clock, Rhythm(RATE_HZ), [100] * 200, factor)
    assert sent_s[-1] <= 1000.0 + 200.0 / factor + 1e-6
    assert sent_s[-1] - sent_s[-100] < 1e-6


def test_a_fast_replay_in_a_loop_is_held_up_for_a_moment_a_lap(clock):
    """Its stamps go back, so its ages go up, every second."""
    rhythm = Rhythm(RATE_HZ)
    for lap in range(10):
        run(clock, rhythm, [100] * 40, 40.0)
    assert clock.now_s <= 1000.0 + 10 * (1.0 + 1.0 / CATCH_UP)


def test_no_backlog_is_spread_for_longer_than_patience(clock):
    """However long the publisher was held up, and whatever the stamps make believe."""
    rhythm = Rhythm(RATE_HZ)
    rhythm.heard(np.array([10**7]))
    for _ in rhythm.spread(range(100_000)):
        pass
    assert clock.now_s <= 1000.0 + PATIENCE_S + 0.1


def test_attitudes_that_were_held_up_by_the_first_frame_go_out_in_a_rhythm(
        start, peer, tmp_path):
    """The stars come 1.2 s after their readings, so that 170 attitudes are there at once.

    When each was sent tells the middleware: a test that is held up itself does not show in that.
    """
    config = tmp_path / 'config.yaml'
    config.write_text(parameter_file.dump(TAN2018))
    start('estimator', '--params-file', str(config))
    heard = []
    peer.node.create_subscription(Imu, 'starcal/imu', lambda message, info: heard.append(
        (message, info['source_timestamp'])), QoSProfile(depth=1000))
    peer.meet()
    peer.until(lambda: peer.node.count_publishers('starcal/imu') == 1)
    gyro, frames = sensors.gyro(TAN2018).next(400), sensors.star_tracker(TAN2018).next(8)
    start_ns = frames.stamp_ns[0]
    due = sorted([*((stamp, peer.gyro, message.tobytes()) for stamp, message in zip(
        gyro.stamp_ns - start_ns, cdr_imu.encode_imu(gyro))), *(
            (stamp + 1_200_000_000, peer.frames, message) for stamp, message in zip(
                frames.stamp_ns - start_ns, cdr_pointcloud.encode_centroids(frames)))],
        key=lambda item: item[0])
    began_ns = time.monotonic_ns()

    def over():
        while due and due[0][0] < time.monotonic_ns() - began_ns:
            _, publisher, message = due.pop(0)
            publisher.publish(message)
        return not due and len(heard) == len(gyro)

    while not over():
        assert time.monotonic_ns() - began_ns < 30 * 10**9
        rclpy.spin_once(peer.node, timeout_sec=0.002)
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
              for message, _ in heard]
    np.testing.assert_array_equal(stamps, gyro.stamp_ns)
    sent_s = 1e-9 * (np.array([at for _, at in heard]) - heard[0][1])
    within = np.searchsorted(sent_s, sent_s + 0.025) - np.arange(len(sent_s))
    assert within.max() <= BURST + 1 + 0.025 * CATCH_UP * RATE_HZ
