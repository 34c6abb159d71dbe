# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What stamps say by themselves."""

import numpy as np
import pytest

from starcal_ros.checks.frame_ids import of_frame_ids
from starcal_ros.checks.stamps import LogTimes, known_difference, of_clocks, of_topic
from starcal_ros.core.utc import unix_ns

BEGIN = unix_ns('2026-07-02T12:00:00')
PERIOD = 10_000_000
STAMPS = BEGIN + PERIOD * np.arange(2000)
FRAMES = BEGIN + 500_000_000 * np.arange(40)


def kinds(found):
    return [each.kind for each in found]


def of_gyro(stamps, stated=100.0):
    return list(of_topic('gyro readings', stamps, 'gyro.rate_hz', stated, 'driver of the gyro'))


def test_regular_stamps_at_the_stated_rate_are_right():
    assert of_gyro(STAMPS) == []
    assert of_gyro(np.delete(STAMPS, slice(300, 900))) == []            # a silence is no rate
    rng = np.random.default_rng(1)
    assert of_gyro(STAMPS + rng.integers(-500_000, 500_000, len(STAMPS))) == []


def test_a_rate_that_is_not_the_stated_one_is_proposed():
    found, = of_gyro(STAMPS, 200.0)
    assert found.kind == 'rate' and found.parameters == {'gyro.rate_hz': 100.0}
    assert '100 Hz' in found.sentence and 'silence' in found.sentence


def test_bursts_irregular_repeated_and_missing_stamps_are_told_apart():
    burst = np.repeat(STAMPS[9::10], 10) + np.arange(len(STAMPS)) % 10 * 20_000
    assert kinds(of_gyro(burst)) == ['bursts']
    late = np.random.default_rng(1).exponential(4e6, len(STAMPS)).astype(np.int64)
    assert kinds(of_gyro(np.maximum.accumulate(STAMPS + late) + np.arange(2000))) == [
        'irregular stamps']
    assert kinds(of_gyro(np.repeat(STAMPS[::2], 2)[:2000], 50.0))[0] == 'stamps go back'
    assert kinds(of_gyro(0 * STAMPS)) == ['no stamps']


@pytest.mark.parametrize(('seconds', 'text'), [
    (37.0, 'TAI'), (-18.0, 'GPS'), (3600.0, '1 h: a time zone'), (19800.5, '5.5 h'),
    (-7200.0, '2 h')])
def test_differences_of_clocks_that_have_a_name(seconds, text):
    assert text in known_difference(seconds).name


@pytest.mark.parametrize('seconds', [0.0, 5.0, 36.0, 100.0, 4000.0, 86400.0])
def test_other_differences_have_none(seconds):
    assert known_difference(seconds) is None


def test_clocks_that_differ_are_told_and_those_that_overlap_are_not():
    assert list(of_clocks(STAMPS, FRAMES)) == []
    assert list(of_clocks(STAMPS[500:], FRAMES)) == []              # one that began later
    found, = of_clocks(STAMPS + 3600 * 10**9, FRAMES)
    assert found.kind == 'clocks' and 'a time zone' in found.sentence
    assert found.driver == {'gyro_stamps_plus_s': -3600.0}
    boot, = of_clocks(STAMPS - BEGIN + 10**10, FRAMES)
    assert boot.kind == 'clocks' and '1970-01-01T00:00:10' in boot.sentence


def test_dates_that_no_camera_has_and_logs_of_a_time_zone():
    early, = of_clocks(STAMPS - BEGIN, FRAMES - BEGIN)
    assert early.kind == 'no UTC'
    assert early.sentence.endswith('displaces stars by up to 41 arcsec')
    by_sigma, = of_clocks(STAMPS - BEGIN, FRAMES - BEGIN, None, 2.61)       # T18's 0.05 px
    assert by_sigma.sentence == f'{early.sentence}, 16 sigmas of a centroid'
    assert list(of_clocks(STAMPS, FRAMES, LogTimes(BEGIN + 10**9, None))) == []
    zone, = of_clocks(STAMPS, FRAMES, LogTimes(BEGIN + 7200 * 10**9, None))
    assert zone.kind == 'stamps and log' and '2 h' in zone.sentence
    assert list(of_clocks(STAMPS, FRAMES, LogTimes(BEGIN + 10**17, None))) == []    # a replay


@pytest.mark.parametrize(('gyro', 'frames', 'count'), [
    ('gyro', 'star_tracker_optical', 0), ('imu_link', 'camera', 0), ('', '', 0), (None, 'x', 0),
    ('star_tracker_optical', 'gyro', 2), ('base_link', 'base_link', 1), ('icrf', 'camera', 1)])
def test_frames_that_cannot_be_meant(gyro, frames, count):
    assert kinds(of_frame_ids(gyro, frames)) == ['frame_id'] * count
