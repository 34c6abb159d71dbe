# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What waits, and what is kept, does not grow with the hours."""

import numpy as np

from starcal_ros.filter import message_queue
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.measurements.samples import Frames, GyroSamples
from streams import SCENARIO, SECOND_NS, START_NS, calibrated


def test_gyro_without_frames_does_not_grow_without_bound():
    """Half a day of samples, an hour of them kept."""
    scenario = SCENARIO.replace({'gyro.rate_hz': 1.0, 'star_tracker.rate_hz': 0.01})
    calibrator = Calibrator(scenario)
    for hour in range(12):
        stamps = START_NS + (hour * 3600 + np.arange(3600)) * SECOND_NS
        calibrator.add_gyro(GyroSamples(stamps, np.zeros((3600, 3))))
        list(calibrator.process())
        assert held(calibrator) <= 2 * 3600 + 1
    assert calibrator.counts.gyro == 12 * 3600
    assert calibrator.counts.dropped_messages == 12 * 3600 - held(calibrator)
    assert sum('oldest gyro readings are dropped' in text
               for text in calibrator.take_notices()) == 1


def held(calibrator):
    """Return how many readings and frames a calibrator keeps."""
    return len(calibrator._queue.gyro) + calibrator.waiting


def test_frames_without_gyro_do_not_grow_without_bound(run):
    """Before the first reading, and after the last."""
    for gyro in (GyroSamples.empty(), run.gyro[:100]):
        calibrator = Calibrator(SCENARIO)
        calibrator.add_gyro(gyro)
        for k in range(5):
            n = 10_000
            stamps = START_NS + (k * n + np.arange(n)) * SECOND_NS // 2 + 10 * SECOND_NS
            calibrator.add_frames(Frames(stamps, np.zeros(n + 1, np.int64), np.empty((0, 2)),
                                         np.empty(0), np.empty(0), np.empty(0, np.int64)))
            list(calibrator.process())
        assert calibrator.waiting <= 20_000
        assert calibrator.counts.dropped_messages >= 30_000
        assert calibrator.take_notices()


def test_frames_that_the_gyro_has_reached_are_used_however_many(run, monkeypatch):
    """The bound, here of 9, is on those that wait alone."""
    monkeypatch.setattr(message_queue, 'FRAMES_KEPT', 9)
    calibrator, results = calibrated(run.gyro, run.frames)
    assert len(results) == 180 and calibrator.counts.dropped_messages == 0


def test_used_messages_are_forgotten(run, at_once):
    assert held(at_once[0]) <= 52           # samples since the last frame, and one before
