# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a long recording is found in the parts of it that are looked at."""

from dataclasses import replace

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.cli.check import check_recording
from starcal_ros.recording.excerpt import EXCERPT_S
from starcal_ros.recording.recording_stream import RecordingStream
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch
from starcal_ros.simulation import sensors

HOURS = 2.0
LONG = TAN2018.replace({'simulation.duration_s': 3600.0 * HOURS, 'gyro.rate_hz': 10.0,
                        'star_tracker.rate_hz': 0.5, 'star_tracker.limiting_magnitude': 5.5})


@pytest.fixture(scope='module')
def messages():
    assert LONG.simulation.duration_s >= 3.0 * EXCERPT_S
    gyro, tracker = sensors.gyro(LONG), sensors.star_tracker(LONG)
    return gyro.next(gyro.count), tracker.next(tracker.count)


def late(shift_s):
    """Return what stamps frames by so much too late, a function of hours."""
    def spoilt(gyro, frames):
        hours = (frames.stamp_ns - frames.stamp_ns[0]) / 3.6e12
        shift = np.rint(1e9 * shift_s(hours)).astype(np.int64)
        return gyro, replace(frames, stamp_ns=frames.stamp_ns + shift)
    return spoilt


@pytest.mark.parametrize('spoil, kind, value', [
    (late(np.zeros_like), None, 0.0),
    (late(lambda hours: np.full_like(hours, 0.005)), 'time offset', -5.0),
    (late(lambda hours: 1e-5 * 3600.0 * (hours - HOURS / 2)), 'drift of a clock', -10.0),
    (late(lambda hours: np.where(hours > 0.9, 0.04, 0.0)), 'step of a clock', -40.0),
    (lambda gyro, frames: (replace(gyro, rate=gyro.rate * 1.0005), frames), 'gyro scale', 500.0),
], ids=lambda each: each if isinstance(each, str) else '')
def test_it_is_named_with_its_size(tmp_path, messages, spoil, kind, value):
    gyro, frames = spoil(*messages)
    path = tmp_path / 'long.mcap'
    with Writer(path) as writer:
        writer.write_batches(imu_batch('/imu/data_raw', gyro),
                             centroids_batch('/star_tracker/centroids', frames))
    found = check_recording(RecordingStream(path), LONG).findings
    assert [each.kind for each in found] == ([kind] if kind else [])
    for each in found:
        assert abs(each.value[-1] - value) < 4.5 * each.sigma[-1] < 0.2 * abs(value)
