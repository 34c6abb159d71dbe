# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What no sensor gives is left out, counted and named once; the bounds are the user's."""

from dataclasses import replace

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.utc import unix_ns
from starcal_ros.measurements.intake import Intake
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.plausible import Plausible
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.simulation import sensors

SECOND_NS = 10**9
START_NS = unix_ns('2026-07-02T12:00:00')


def readings(stamps_ns):
    return GyroSamples(np.array(stamps_ns, np.int64), np.zeros((len(stamps_ns), 3)))


@pytest.fixture(scope='module')
def frames():
    return sensors.star_tracker(TAN2018).next(6)


def shifted(frames, rows, stamps_ns):
    stamps = frames.stamp_ns.copy()
    stamps[rows] = stamps_ns
    return replace(frames, stamp_ns=stamps)


WRONG = {'since the machine started': 4711 * SECOND_NS, 'the least': np.iinfo(np.int64).min,
         'before the first': unix_ns('2000-01-01T00:00:00') - 1,
         'after the last': unix_ns('2100-01-01T00:00:00') + 1, 'the largest': 2**63 - 1}


@pytest.mark.parametrize('stamp_ns', WRONG.values(), ids=WRONG)
def test_a_stamp_of_another_time_is_dropped_counted_and_named_once(frames, stamp_ns):
    notices = Notices()
    plausible = Plausible(Scenario(), notices)
    stamps = START_NS + np.arange(10) * SECOND_NS // 100
    stamps[[2, 5]] = stamp_ns
    np.testing.assert_array_equal(plausible.gyro(readings(stamps)).stamp_ns,
                                  np.delete(stamps, [2, 5]))
    kept = plausible.frames(shifted(frames, [1, 4], stamp_ns))
    expected = frames.take(np.array([0, 2, 3, 5]))
    np.testing.assert_array_equal(kept.stamp_ns, expected.stamp_ns)
    np.testing.assert_array_equal(kept.uv_raster, expected.uv_raster)
    assert (plausible.take_dropped(), plausible.take_dropped()) == (4, 0)
    bound = 'earliest_utc' if stamp_ns < START_NS else 'latest_utc'
    first, second = notices.take()
    assert first.startswith('gyro reading stamped ') and second.startswith('frame stamped ')
    assert f'estimator.{bound} is 2' in first and first.endswith(': dropped')
    plausible.gyro(readings([stamp_ns]))
    assert notices.take() == []


def test_the_time_is_the_users():
    scenario = Scenario().replace({'estimator.earliest_utc': '1970-01-01T00:00:00'})
    stamps = [4711 * SECOND_NS, 4712 * SECOND_NS]
    assert len(Plausible(scenario, Notices()).gyro(readings(stamps))) == 2
    with pytest.raises(ConfigError, match='estimator.latest_utc: .*1999.* later than'):
        Scenario().replace({'estimator.latest_utc': '1999-01-01T00:00:00'})
    with pytest.raises(ConfigError, match='estimator.earliest_utc: got .noon.'):
        Scenario().replace({'estimator.earliest_utc': 'noon'})


def test_what_is_dropped_is_counted_with_the_rest_of_the_intake():
    intake = Intake(Scenario(), Notices())
    stamps = START_NS + np.arange(50) * SECOND_NS // 100
    stamps[[10, 30]] = 0, stamps[9]
    intake.add_gyro(readings(stamps))
    assert intake.take_dropped() == 2           # one of another time, one that came twice
    np.testing.assert_array_equal(intake.take()[0].stamp_ns, np.delete(stamps, [10, 30]))


@pytest.mark.parametrize('periods, believed', [(5.0, False), (20.0, True)])
def test_how_far_ahead_a_stamp_may_be_by_itself_is_the_users(periods, believed):
    scenario = Scenario().replace({'estimator.leap_periods': periods})
    intake = Intake(scenario, Notices())
    stamps = START_NS + np.append(np.arange(50), 49 + 10) * SECOND_NS // 100
    intake.add_gyro(readings(stamps))
    assert len(intake.take()[0]) == 50 + believed


@pytest.mark.parametrize('values, column, value', [
    ({'star_tracker.largest_sigma_px': 2.0}, 'sigma', 3.0),
    ({}, 'sigma', 101.0),
    ({}, 'uv_raster', 511.5 + 1.11 * 512.0),
    ({'star_tracker.margin': 0.0}, 'uv_raster', 511.5 + 1.01 * 512.0)])
def test_a_star_beyond_the_bounds_is_unusable_and_its_frame_is_not(frames, values, column, value):
    bounds = {'star_tracker.largest_sigma_px': 1000.0, 'star_tracker.margin': 0.2}
    column_of = getattr(frames, column).copy()
    column_of[3] = value
    changed = replace(frames, **{column: column_of})
    notices = Notices()
    sigma = StarDirections(TAN2018.replace(values)).of(changed, notices).sigma
    assert np.flatnonzero(np.isinf(sigma)).tolist() == [3]
    notice, = notices.take()
    name = 'star_tracker.largest_sigma_px' if column == 'sigma' else 'star_tracker.margin'
    assert name in notice and notice.endswith(': unusable')
    assert np.isfinite(StarDirections(TAN2018.replace(bounds)).of(changed).sigma).all()
