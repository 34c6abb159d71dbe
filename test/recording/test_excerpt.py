# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A long recording is looked at in parts: at its ends, between them, and where it moves."""

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.recording import excerpt
from starcal_ros.recording.recording_stream import RecordingStream
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch
from starcal_ros.simulation import sensors
from starcal_ros.simulation.write_recording import simulate

SHORT = TAN2018.replace({'simulation.duration_s': 40.0})
START = sensors.gyro(SHORT).stamp_ns(0) // 10**9 * 10**9
IMU, STARS = '/imu/data_raw', '/star_tracker/centroids'


def moving(tmp_path, at_s):
    """Return a recording of an hour and a half in which the gyro turns for a minute."""
    stamp_ns = START + np.arange(1, 5401) * 10**9
    rate = np.full((5400, 3), 1e-5)
    rate[at_s:at_s + 60, 1] = 0.01
    frames = sensors.star_tracker(SHORT).next(1)
    many = Frames(stamp_ns[::10], np.zeros(541, np.int64), *(
        getattr(frames, name)[:0] for name in ('uv_raster', 'sigma', 'magnitude', 'catalog_id')))
    path = tmp_path / f'{at_s}.mcap'
    with Writer(path) as writer:
        writer.write_batches(imu_batch(IMU, GyroSamples(stamp_ns, rate)),
                             centroids_batch(STARS, many))
    return RecordingStream(path)


@pytest.mark.parametrize('at_s', [1300, 2150, 4000])
def test_a_long_recording_is_looked_at_in_parts_and_where_it_moves(tmp_path, at_s):
    stream = moving(tmp_path, at_s)
    found = excerpt.excerpt(stream).gyro
    since_s = (found.stamp_ns - START) * 1e-9
    assert excerpt.EXCERPT_S * 0.98 < len(found) < excerpt.EXCERPT_S * 1.02
    assert since_s[0] == 1.0 and since_s[-1] == 5400.0
    assert (np.diff(since_s) > 0.0).all() and (np.diff(since_s) > 100.0).any()
    assert (found.rate[:, 1] > 0.005).sum() >= 30


def test_a_short_recording_is_looked_at_whole(tmp_path):
    simulate(SHORT, tmp_path / 'run.mcap')
    found = excerpt.excerpt(RecordingStream(tmp_path / 'run.mcap'))
    assert (len(found.gyro), len(found.frames)) == (4000, 80)
