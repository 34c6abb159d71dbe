# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The first minutes of a live run are checked beside it, and each kind is told once."""

import time

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.simulation import sensors

SCENARIO = TAN2018.replace({'simulation.duration_s': 310.0, 'motion.dwell_s': 2.0,
                            'motion.rate_deg_s': 1.5})


def told(first, gyro, frames):
    """Return what is found of messages that come in ten parts."""
    found = []
    for k in range(10):
        first.add_gyro(gyro[k * len(gyro) // 10:(k + 1) * len(gyro) // 10])
        first.add_frames(frames[k * len(frames) // 10:(k + 1) * len(frames) // 10])
        end = time.monotonic() + 60.0
        while first._busy and time.monotonic() < end:
            time.sleep(0.05)
        found += first.take()
    return found


def test_a_gyro_that_runs_for_a_day_without_stars_does_not_fill_the_memory():
    """Those of the last minutes are there when the stars come, as are their frames."""
    pytest.importorskip('rclpy')
    from starcal_ros.nodes.estimator_check import KEPT_S, FirstMinutes
    first, tracker = FirstMinutes(SCENARIO), sensors.star_tracker(SCENARIO)
    first.add_frames(tracker.next(100))
    begin = tracker.next(1).stamp_ns[0]
    for k in range(24 * 60):
        first.add_gyro(GyroSamples(begin + (60 * k + np.arange(60)) * 10**9, np.zeros((60, 3))))
        assert sum(map(len, first._gyro)) <= KEPT_S * SCENARIO.gyro.rate_hz
    for _ in range(100):
        first.add_gyro(GyroSamples(begin + 10**15 + np.arange(6000) * 10**7, np.zeros((6000, 3))))
    assert sum(map(len, first._gyro)) <= KEPT_S * SCENARIO.gyro.rate_hz
    assert not first._frames and first._count == 0


def test_what_is_wrong_is_told_once_and_what_is_right_not_at_all():
    pytest.importorskip('rclpy')
    from starcal_ros.nodes.estimator_check import FirstMinutes
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    right = FirstMinutes(SCENARIO)
    assert told(right, samples, frames) == [] and right.checked.findings == ()
    first = FirstMinutes(SCENARIO)
    found, = told(first, GyroSamples(samples.stamp_ns, np.degrees(samples.rate)), frames)
    assert found.kind == 'unit of the rates'
    assert [each.kind for each in first.checked.findings] == ['unit of the rates']


@pytest.mark.parametrize('lap_s', [200.0, 297.0])
def test_a_recording_that_is_played_again_and_again_is_no_fault_of_the_driver(lap_s):
    """The second check would have had two laps, or have begun when the clock was just set back."""
    pytest.importorskip('rclpy')
    from starcal_ros.filter.calibrator import Calibrator
    from starcal_ros.nodes.estimator_check import FirstMinutes
    lap = SCENARIO.replace({'simulation.duration_s': lap_s})
    first, calibrator, found = FirstMinutes(lap), Calibrator(lap), []
    for _ in range(3):
        gyro, tracker = sensors.gyro(lap), sensors.star_tracker(lap)
        for _ in range(0, tracker.count, 10):
            samples, frames = gyro.next(500), tracker.next(10)
            for into in (calibrator, first):
                into.add_gyro(samples)
                into.add_frames(frames)
            for _ in calibrator.process():
                pass
            first.restarted(calibrator.counts.restarts)
            end = time.monotonic() + 60.0
            while first._busy and time.monotonic() < end:
                time.sleep(0.01)
            found += first.take()
    assert calibrator.counts.restarts == 2
    assert found == [] and first.checked is not None
