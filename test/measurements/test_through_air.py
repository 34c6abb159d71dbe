# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings that were made on the ground: the stars are where the air shows them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import TAN2018, calibrated
from starcal_ros import calibration
from starcal_ros.config import models
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import from_flat
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky.apparent import Observer
from starcal_ros.sky.refraction import LOWEST_DEG, Site, altitude, refracted

GROUND = TAN2018.replace({
    'simulation.duration_s': 300.0, 'motion.axes': ('x', 'y', 'x', 'y'),
    'motion.angles_deg': (10.0, 10.0, -10.0, -10.0), 'motion.dwell_s': 5.0})


def overhead(scenario, altitude_deg=50.0):
    """Return where on the Earth the camera looks up at the start."""
    truth, frame = Truth.from_scenario(scenario), sensors.star_tracker(scenario).next(1)
    z = truth.attitude_si(frame.stamp_ns)[0, 2]
    sites = [(latitude, longitude) for latitude in range(-60, 61, 10)
             for longitude in range(-180, 180, 10)]
    off = [abs(np.degrees(altitude(z[None], frame.stamp_ns, Site(*at))[0]) - altitude_deg)
           for at in sites]
    return {'observer.site_deg': tuple(map(float, sites[int(np.argmin(off))])),
            'observer.site_pressure_hpa': 1000.0, 'observer.site_temperature_c': 10.0}


@pytest.fixture(scope='module')
def site():
    return overhead(GROUND)


def test_directions_are_those_of_the_vacuum_raised_by_the_air(site):
    frames = sensors.star_tracker(GROUND).next(20)
    vacuum, air = (StarDirections(each).of(frames) for each in (GROUND, GROUND.replace(site)))
    where = models.observer(GROUND.replace(site).observer).site
    assert where == Site(*site['observer.site_deg'], 0.0, 1000.0, 10.0)
    expected = refracted(vacuum.u_i, frames.stamp_ns[frames.frame_index], where)
    np.testing.assert_allclose(air.u_i, expected, atol=1e-15)
    raised = np.degrees(altitude(air.u_i, frames.stamp_ns[frames.frame_index], where)
                        - altitude(vacuum.u_i, frames.stamp_ns[frames.frame_index], where)) * 3600
    assert ((20.0 < raised) & (raised < 200.0)).all()


def test_stars_that_are_too_low_are_unusable():
    frames, notices = sensors.star_tracker(GROUND).next(20), Notices()
    scenario = GROUND.replace(overhead(GROUND, 5.0))
    found = StarDirections(scenario).of(frames, notices)
    where = models.observer(scenario.observer).site
    height = np.degrees(altitude(found.u_i, frames.stamp_ns[frames.frame_index], where))
    np.testing.assert_array_equal(np.isfinite(found.sigma), height >= LOWEST_DEG)
    assert 0 < np.isfinite(found.sigma).sum() < len(height)
    assert any('lower than 5 deg' in text for text in notices.take())


@pytest.mark.parametrize('method', ['bundle', 'angular_distance'])
def test_a_camera_on_the_ground_is_right_where_the_site_is_stated(site, method):
    stated = GROUND.replace({**site, 'intrinsics.method': method})
    tracker, true = sensors.star_tracker(stated), Truth.from_scenario(stated).intrinsics
    frames = tracker.next(tracker.count)
    errors = []
    for scenario in (stated, GROUND.replace({'intrinsics.method': method})):
        begun = calibration.start(scenario)
        begun.add_frames(frames)
        estimate = begun.estimate()
        error = estimate.intrinsics - true
        errors.append(error @ np.linalg.solve(estimate.covariance, error))
    assert errors[0] < chi2.ppf(0.9999, 7) and errors[1] > 10.0 * chi2.ppf(0.9999, 7)


def test_the_filter_is_right_where_the_site_is_stated(site):
    """T18's filter, of an attitude that is inertial: the air is in the places of the stars."""
    stated = GROUND.replace(site)
    calibrator = calibrated(stated)
    error = calibrator.belief.estimate.intrinsics - Truth.from_scenario(stated).intrinsics
    covariance = calibrator.belief.covariance[9:16, 9:16]
    assert error @ np.linalg.solve(covariance, error) < chi2.ppf(0.9999, 7)
    assert all(each.passed for each in calibrator.consistency.statistics())
    without = calibrated(GROUND, stated)
    assert not all(each.passed for each in without.consistency.statistics())


def test_truth_may_have_other_air(site):
    other = GROUND.replace({**site, 'truth.observer.site_pressure_hpa': 0.0})
    frames = sensors.star_tracker(other).next(3)
    vacuum = sensors.star_tracker(GROUND).next(3)
    np.testing.assert_allclose(frames.uv_raster, vacuum.uv_raster, atol=1e-6)


def test_what_can_not_be_is_said():
    for values, culprit in (
            ({'observer.site_deg': (95.0, 8.0)}, 'observer.site_deg: got a latitude of 95'),
            ({'observer.site_deg': (45.0, 8.0), 'observer.velocity': 'orbit'},
             'observer.site_deg: got a site on the ground and velocity orbit')):
        with pytest.raises(ConfigError, match=culprit):
            from_flat(values)
    with pytest.raises(ValueError, match='in orbit has no site'):
        replace(Observer('orbit'), site=Site(45.0, 8.0))
