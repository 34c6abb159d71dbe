# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which messages of two topics are believed, however they are cut and interleaved."""

import numpy as np
import pytest

from starcal_ros.config.scenario import Scenario
from starcal_ros.measurements.intake import Change, Intake
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.samples import Frames, GyroSamples

SECOND_NS = 10**9
START_NS = 1_782_993_600 * SECOND_NS
SCENARIO = Scenario().replace({'gyro.rate_hz': 10.0, 'star_tracker.rate_hz': 1.0})
DAY_NS = 86_400 * SECOND_NS


def readings(count, start_ns=START_NS):
    return GyroSamples(start_ns + SECOND_NS // 10 * np.arange(count), np.zeros((count, 3)))


def frames(count, start_ns=START_NS):
    n = np.zeros(0)
    return Frames(start_ns + SECOND_NS * np.arange(count), np.zeros(count + 1, np.int64),
                  np.empty((0, 2)), n, n, n.astype(np.int64))


@pytest.fixture
def intake():
    return Intake(SCENARIO, Notices())


def taken(intake):
    """Return the numbers of readings and frames taken, and their stamps joined."""
    gyro, part = intake.take()
    return gyro.stamp_ns, part.stamp_ns


def test_nothing_is_taken_twice(intake):
    intake.add_gyro(readings(20))
    intake.add_frames(frames(5))
    gyro_ns, frames_ns = taken(intake)
    np.testing.assert_array_equal(gyro_ns, readings(20).stamp_ns)
    np.testing.assert_array_equal(frames_ns, frames(5).stamp_ns)
    assert [len(part) for part in taken(intake)] == [0, 0]
    assert intake.take_dropped() == 0 and intake.settle() is None


def test_a_reading_that_no_gyro_gives_is_dropped_counted_and_named():
    notices = Notices()
    intake, samples = Intake(SCENARIO, notices), readings(20)
    samples.rate[7, 1], samples.rate[9], samples.rate[11, 2] = 100.0, np.inf, np.nan
    samples.rate[13, 0] = np.radians(2000.0)
    intake.add_gyro(samples)
    np.testing.assert_array_equal(taken(intake)[0], np.delete(samples.stamp_ns, [7, 9, 11]))
    assert (intake.take_dropped(), intake.take_dropped()) == (3, 0)
    assert notices.take() == [
        f'gyro reading at {samples.stamp_ns[7]} ns is 0, 100, 0 rad/s, '
        'gyro.largest_rate_deg_s is 2000: dropped']


def test_a_magnitude_that_no_star_has_is_not_known():
    intake, magnitude = Intake(SCENARIO, Notices()), np.array([5.0, np.nan, 1e30, -np.inf])
    intake.add_frames(Frames(frames(5).stamp_ns, np.array([0, 4, 4, 4, 4, 4]), np.zeros((4, 2)),
                             np.ones(4), magnitude, np.ones(4, np.int64)))
    np.testing.assert_array_equal(intake.take()[1].magnitude, [5.0, np.nan, np.nan, np.nan])


@pytest.mark.parametrize('topic', ['gyro', 'frames'])
@pytest.mark.parametrize('row', [0, 5, 18])
def test_one_message_stamped_a_day_ahead_costs_that_message(intake, topic, row):
    good = readings(20) if topic == 'gyro' else frames(20)
    good.stamp_ns[row] += DAY_NS
    (intake.add_gyro if topic == 'gyro' else intake.add_frames)(good)
    believed = taken(intake)[0 if topic == 'gyro' else 1]
    np.testing.assert_array_equal(believed, np.delete(good.stamp_ns, row))
    assert intake.take_dropped() == 1


def test_both_clocks_set_back_begin_a_new_stretch():
    notices = Notices()
    intake = Intake(SCENARIO, notices)
    for _ in range(2):
        intake.add_gyro(readings(100))
        intake.add_frames(frames(10))
    assert [len(part) for part in taken(intake)] == [100, 10]
    assert intake.waiting == 10
    assert intake.settle() is Change.RESTARTED
    assert [len(part) for part in taken(intake)] == [100, 10]
    assert intake.settle() is None
    assert notices.take() == [f'stamps went back by 9.900 s to {START_NS} ns: started again']


def test_frames_alone_begin_a_new_stretch_where_there_is_no_gyro(intake):
    intake.add_frames(frames(10))
    assert len(taken(intake)[1]) == 10
    intake.add_frames(frames(10))
    assert intake.settle() is Change.RESTARTED
    assert len(taken(intake)[1]) == 10


def test_frames_set_back_wait_while_the_gyro_has_not_been(intake):
    intake.add_gyro(readings(100))
    intake.add_frames(frames(10))
    intake.take()
    intake.add_frames(frames(10))
    assert intake.settle() is None
    intake.add_gyro(readings(100))
    assert intake.settle() is Change.RESTARTED


def test_a_topic_that_was_set_back_alone_rejoins_the_other(intake):
    """Its clock is an hour behind for ten seconds; what came then is dropped."""
    intake.add_gyro(readings(400))
    stamps = frames(40)
    stamps.stamp_ns[10:20] -= 3600 * SECOND_NS
    intake.add_frames(stamps)
    intake.take()
    assert intake.settle() is Change.REJOINED
    np.testing.assert_array_equal(taken(intake)[1], frames(40).stamp_ns[20:])
    assert intake.take_dropped() == 10 and intake.settle() is None
