# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How long a calibration will take: against closed forms, and against runs that went on."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from instruments import TAN2018
from starcal_ros.core.units import ARCSEC, DEG_PER_HOUR
from starcal_ros.filter import progress
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.offline import calibrate
from starcal_ros.filter.progress import Progress
from starcal_ros.filter.states import CALIBRATED, N_STATES
from starcal_ros.filter.verdict import judge
from starcal_ros.simulation import sensors

FILTER = Filter(TAN2018)


def sigma_after(seconds, per_tolerance_s):
    """Return sigmas whose information reaches that of the tolerance after a time."""
    sigma = np.ones(N_STATES)
    sigma[CALIBRATED] = FILTER.tolerance * np.sqrt(per_tolerance_s / seconds)
    return sigma


def constant(until_s, per_tolerance_s=4000.0, filter_=FILTER):
    """Return what is left after a run of a constant gain."""
    seen = Progress((int(t * 1e9), sigma_after(t, per_tolerance_s))
                    for t in np.arange(0.5, until_s + 0.25, 0.5))
    return seen.remaining_s(filter_, sigma_after(until_s, per_tolerance_s))


@pytest.mark.parametrize('until_s', [130.0, 1000.0, 3999.0])
def test_of_a_constant_gain_the_time_is_exact(until_s):
    np.testing.assert_allclose(constant(until_s), 4000.0 - until_s, rtol=1e-6)


def test_states_inside_their_tolerance_take_no_time_and_no_gain_takes_for_ever():
    left = progress.time_to_reach(np.array([4.0, 4.0, 4.0, 4e9]), np.array([5.0, 1.0, 1.0, 1.0]),
                                  np.array([0.0, 0.0, -1.0, 1.0]), np.zeros(4))
    assert left.tolist() == [0.0, np.inf, np.inf, np.inf]


def test_a_short_run_says_nothing():
    assert Progress().remaining_s(FILTER, np.ones(N_STATES)) is None
    assert constant(119.0) is None


def test_a_run_of_any_length_costs_the_same_and_one_that_begins_anew_is_another():
    seen = Progress((int(t * 1e9), sigma_after(t, 1e6)) for t in range(1, 50_000))
    assert len(seen._points) <= progress._KEPT
    np.testing.assert_allclose(seen.remaining_s(FILTER, sigma_after(50_000, 1e6)), 950_000.0,
                               rtol=1e-2)
    seen.add(0, np.ones(N_STATES))
    assert seen.remaining_s(FILTER, np.ones(N_STATES)) is None


def test_no_bias_gains_faster_than_the_random_walk_lets_it():
    """At most 1 / N^2 per second: (N / tolerance)^2 in all, whatever the last minutes gained."""
    coarse = Filter(TAN2018.replace({'gyro.arw_deg_sqrt_h': 0.01}))
    left = constant(130.0, per_tolerance_s=400.0, filter_=coarse)
    bound = (coarse.walk / coarse.tolerance[0])**2
    np.testing.assert_allclose(left[:3], bound * (1.0 - 130.0 / 400.0))
    np.testing.assert_allclose(left[3:], 270.0, rtol=1e-6)


@pytest.mark.parametrize('begin, wanted', [(0.2, 1.5), (1.0, 1.9), (0.01, 0.02)])
def test_walking_states_take_what_the_equation_says(begin, wanted):
    """dI/dt = g - q^2 I^2, integrated numerically; its end is 2."""
    q, g = 0.05, 0.01
    run = solve_ivp(lambda t, I_: g - (q * I_)**2, (0.0, 500.0), [begin], rtol=1e-10, atol=1e-12,
                    events=lambda t, I_: I_[0] - wanted)
    left, = progress.time_to_reach(np.array([wanted]), np.array([begin]), np.array([g]),
                                   np.array([q]))
    assert left == pytest.approx(run.t_events[0][0], rel=1e-6)


def test_walking_states_do_not_get_beyond_their_end():
    left = progress.time_to_reach(np.array([2.1]), np.array([1.0]), np.array([0.01]),
                                  np.array([0.05]))
    assert left.tolist() == [np.inf]


# What no motion reaches


def test_nothing_is_out_of_reach_of_the_shipped_instrument():
    assert progress.unreachable(FILTER) == {}


def test_a_bias_that_takes_years_is_out_of_reach():
    """ARW / sqrt(T) = 0.001 / sqrt(1e6 h)."""
    filter_ = Filter(TAN2018.replace({'estimator.tolerance.gyro_bias_deg_h': 1e-6}))
    assert progress.unreachable(filter_) == dict.fromkeys(
        ('epsilon_x', 'epsilon_y', 'epsilon_z'), 'ARW/√T takes 1e+06 h')


@pytest.mark.parametrize('walk_deg_h_sqrt_h, out', [(0.0038, 0), (0.0042, 3)])
def test_a_walking_bias_is_out_of_reach_above_the_end_of_its_filter(walk_deg_h_sqrt_h, out):
    """Sqrt(q N) = sqrt(0.004 x 0.001) = 0.002 deg/h."""
    filter_ = Filter(TAN2018.replace(
        {'estimator.process_noise.gyro_bias_deg_h_sqrt_h': walk_deg_h_sqrt_h}))
    assert len(progress.unreachable(filter_)) == out


@pytest.mark.parametrize('ppm, out', [(500.0, True), (10.0, False)])
def test_fixed_angles_stay_as_wide_as_the_gyro_matrix_leaves_them(ppm, out):
    """1 / sigma^2 = 1 / 600^2 + 2 / (ppm in arcsec)^2: 72 arcsec, and 1.5."""
    filter_ = Filter(TAN2018.replace({'estimator.augment.gyro_matrix_sigma_ppm': ppm}))
    width = ppm * 1e-6 / ARCSEC
    np.testing.assert_allclose(progress._turn_sigma(filter_) / ARCSEC,
                               (600.0**-2.0 + 2.0 * width**-2.0)**-0.5)
    said = progress.unreachable(filter_)
    assert set(said) == ({'psi_x', 'psi_y', 'psi_z'} if out else set())
    if out:
        assert said['psi_x'].endswith('known to 72 arcsec')


# Of the filter


@pytest.mark.parametrize('settings, duration_s', [
    ({}, 1100.0), ({'estimator.tolerance.gyro_bias_deg_h': 0.0013}, 2400.0),
    ({'motion.axes': ('x', 'y', 'y', 'x'), 'motion.angles_deg': (30.0, 30.0, -30.0, -30.0)},
     1100.0),
    ({'star_tracker.centroid_sigma_px': 0.07, 'estimator.tolerance.gyro_bias_deg_h': 0.1},
     2400.0)],
    ids=['as shipped', 'finer bias', 'two axes', 'noisier stars'])
def test_time_is_that_of_a_run_that_goes_on(settings, duration_s):
    """Ten minutes, a cycle of the motion, tell how long it will take to within 30 %."""
    scenario = TAN2018.replace({**settings, 'simulation.duration_s': duration_s})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator, history = calibrate(gyro.next(gyro.count), tracker.next(tracker.count), scenario)
    outside = (history.sigma[:, CALIBRATED] > calibrator.filter.tolerance).any(axis=1)
    seconds = (history.stamp_ns - history.stamp_ns[0]) / 1e9
    actual = seconds[np.flatnonzero(outside)[-1]] - 600.0
    assert 300.0 < actual < seconds[-1] - 600.0 - 1.0
    now = int(np.searchsorted(seconds, 600.0))
    seen = Progress(zip(history.stamp_ns[:now + 1].tolist(), history.sigma))
    left = seen.remaining_s(calibrator.filter, history.sigma[now])
    assert left.max() == pytest.approx(actual, rel=0.3)


def test_verdict_has_the_longest_of_the_times_that_can_be_reached():
    scenario = TAN2018.replace({
        'simulation.duration_s': 600.0, 'estimator.augment.gyro_matrix_sigma_ppm': 500.0})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator, history = calibrate(gyro.next(gyro.count), tracker.next(tracker.count), scenario)
    seen = Progress(zip(history.stamp_ns.tolist(), history.sigma))
    judged = judge(calibrator.filter, calibrator.belief, progress=seen)
    left = seen.remaining_s(calibrator.filter, calibrator.belief.sigma)
    psi = np.arange(13) // 3 == 1
    assert np.isinf(left[psi]).all() or left[psi].max() > 1e5
    assert judged.remaining_s == left[~psi].max() < 1e5
    assert 'min more' in judged.advice
    assert np.isnan(judge(calibrator.filter, calibrator.belief).remaining_s)


def test_bias_tolerance_is_in_the_units_of_the_filter():
    assert FILTER.tolerance[0] == pytest.approx(2e-3 * DEG_PER_HOUR)
