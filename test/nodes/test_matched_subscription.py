# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages may be left to gather: a few together take hardly longer than one."""

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from sensor_msgs.msg import Imu  # noqa: E402

from starcal_ros.nodes.base import matched_subscription, run_loop  # noqa: E402
from starcal_ros.nodes.base import rhythm as rhythm_module  # noqa: E402
from starcal_ros.nodes.base.matched_subscription import MatchedSubscription  # noqa: E402
from starcal_ros.nodes.base.rhythm import Rhythm  # noqa: E402

GATHER_S = 0.05


class Clock:
    """Time that passes when it is told to."""

    now_s = 1000.0

    def monotonic(self):
        return self.now_s


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(matched_subscription, 'time', clock)
    return clock


@pytest.fixture
def listening(peer):
    """Return what begins to listen, and sends some messages that are then there to be taken."""
    class Listening:
        hurried = False

        def begin(self, **options):
            self.batches = []
            self.subscription = MatchedSubscription(
                peer.node, Imu, 'imu/data_raw', lambda batch: self.batches.append(len(batch)),
                raw=True, hurried=lambda: self.hurried, **options)
            peer.until(lambda: self.subscription.publishers == 1
                       and peer.gyro.get_subscription_count() == 1)

        def send(self, count):
            for _ in range(count):
                peer.gyro.publish(Imu())

    listening = Listening()
    yield listening
    listening.subscription.destroy()


def wait_for(subscription, count):
    """Wait until so many messages have been taken, and return how many they are."""
    executor = run_loop._Executor()
    for _ in range(1000):
        if subscription.received >= count:
            break
        subscription.look_again()
        executor.wait_for([subscription])
    executor.shutdown()
    return subscription.received


def test_what_comes_after_a_message_gathers(clock, listening):
    listening.begin(gather_s=GATHER_S)
    listening.send(1)
    assert wait_for(listening.subscription, 1) == 1
    listening.send(3)
    clock.now_s += 0.9 * GATHER_S
    assert listening.subscription.look_again() == 0
    assert 0.0 < listening.subscription.rests_s < GATHER_S
    clock.now_s += 0.2 * GATHER_S
    assert wait_for(listening.subscription, 4) == 4
    assert listening.batches[0] == 1


def test_nothing_gathers_where_somebody_is_in_a_hurry(clock, listening):
    listening.begin(gather_s=GATHER_S)
    listening.send(1)
    wait_for(listening.subscription, 1)
    listening.hurried = True
    listening.send(2)
    assert wait_for(listening.subscription, 3) == 3


def test_nothing_gathers_where_as_many_have_come_as_are_taken(clock, listening):
    listening.begin(gather_s=GATHER_S, at_once=1)
    listening.send(3)
    assert wait_for(listening.subscription, 3) == 3
    assert listening.batches == [1, 1, 1]


def heard(monkeypatch, count, factor):
    """Return a rhythm that has heard readings of 100 Hz at some speed, and its clock."""
    clock = Clock()
    monkeypatch.setattr(rhythm_module, 'time', clock)
    rhythm = Rhythm(100.0)
    for k in range(1, count + 1):
        clock.now_s = 1000.0 + 0.01 * k / factor
        rhythm.heard(np.array([10**7 * k]))
    return rhythm, clock


@pytest.mark.parametrize('rate_hz, gather_s', [
    (0.1, 0.05), (1.0, 0.05), (100.0, 0.05), (1000.0, 0.005)])
def test_readings_gather_for_a_moment_however_slow_they_are(rate_hz, gather_s):
    assert Rhythm(rate_hz).gather_s == pytest.approx(gather_s)


@pytest.mark.parametrize('after_ms, ahead_ms, may', [
    (0, 10, True), (0, 50, False), (30, 45, True), (30, 60, False), (0, -1, True)])
def test_a_reading_may_have_come_by_the_time_that_has_passed(monkeypatch, after_ms, ahead_ms, may):
    rhythm, clock = heard(monkeypatch, 99, 1.0)
    clock.now_s += 1e-3 * after_ms
    assert rhythm.may_have_come(99 * 10**7 + ahead_ms * 10**6) is may


def test_in_a_run_faster_than_real_time_any_reading_may_have_come(monkeypatch):
    rhythm, _ = heard(monkeypatch, 2999, 10.0)
    assert rhythm.may_have_come(10**15)
