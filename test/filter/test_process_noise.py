# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""States that walk at random: the covariance added, and what leaving it out costs."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import INTRINSICS, TAN2018
from starcal_ros.config.estimator import ProcessNoiseConfig
from starcal_ros.core import rotation
from starcal_ros.core.units import ARCSEC, DEG_PER_HOUR
from starcal_ros.filter import process_noise
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import EPSILON, LENS, N_STATES, PSI, SCALE, STATE_NAMES, THETA
from starcal_ros.measurements.preintegration import Preintegrated, preintegrate
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.simulation import sensors

GROUP = 'estimator.process_noise.'
PERIOD_NS = 10**7
SQRT_HOUR = 60.0                                # sqrt(s)
# Each kind of state: its parameter, the states, one human unit.
KINDS = [('gyro_bias_deg_h_sqrt_h', range(3, 6), DEG_PER_HOUR),
         ('fixed_angles_arcsec_sqrt_h', range(6, 9), ARCSEC),
         ('principal_point_px_sqrt_h', range(9, 11), 1.0), ('focal_length_mm_sqrt_h', [11], 1.0),
         ('k1_sqrt_h', [12], 1.0), ('k2_sqrt_h', [13], 1.0), ('p1_sqrt_h', [14], 1.0),
         ('p2_sqrt_h', [15], 1.0)]


def filter_of(**noise):
    """Return a filter of quiet gyros whose states walk."""
    return Filter(TAN2018.replace({'gyro.arw_deg_sqrt_h': 0.0,
                                   **{GROUP + name: value for name, value in noise.items()}}))


def some_values():
    rng = np.random.default_rng(1)
    return Nominal(rotation.exp(rng.normal(size=3)), np.zeros(3), rotation.exp(rng.normal(size=3)),
                   INTRINSICS)


def turning(rate, seconds, parts=1):
    """Return the gyro's account of a turn at a constant rate, in some intervals."""
    n = round(seconds * 100)
    gyro = GyroSamples(np.arange(1, n + 1) * PERIOD_NS, np.tile(rate, (n, 1)))
    intervals = preintegrate(gyro, np.linspace(0, n * PERIOD_NS, parts + 1).astype(np.int64),
                             np.zeros(3), PERIOD_NS)
    return [Preintegrated(*(part[k] for part in intervals)) for k in range(parts)]


def added(filter_, turn):
    """Return the covariance, (16, 16), that walks add to a belief that was certain."""
    belief = Belief(some_values(), np.zeros(N_STATES), np.zeros((N_STATES, N_STATES)))
    for interval in turn:
        belief = filter_.propagate(belief, interval)
    root = SCALE[:, None] * belief.root
    return root @ root.T


def assert_close(actual, expected, part):
    """Compare covariances, each entry against the sigmas of its row and column."""
    sigma = np.sqrt(np.diag(expected))
    scale = np.outer(sigma, sigma) + (expected == 0.0) * np.outer(SCALE, SCALE)
    np.testing.assert_allclose(actual / scale, expected / scale, rtol=0, atol=part)


# Off, and on


def test_nothing_walks_by_default():
    assert all(getattr(TAN2018.estimator.process_noise, item.name) == 0.0
               for item in fields(ProcessNoiseConfig))
    assert not added(filter_of(), turning([0.1, 0.0, 0.0], 0.5)).any()


@pytest.mark.parametrize('name, states, unit', KINDS, ids=[kind[0] for kind in KINDS])
def test_each_kind_of_state_grows_by_its_density_times_the_root_of_time(name, states, unit):
    """36 s are a hundredth of an hour: a tenth of the density."""
    P = added(filter_of(**{name: 2e-3}), turning([0.0, 0.0, 0.0], 36.0))
    sigma = np.sqrt(np.diag(P))
    np.testing.assert_allclose(sigma[states], 2e-4 * unit, rtol=1e-12)
    others = np.setdiff1d(np.arange(3, 16), states)
    assert not sigma[others].any()


def test_walk_of_the_bias_at_rest_is_that_of_the_textbook():
    """The integral of a walk: q^2 T^3 / 3, with the walk q^2 T^2 / 2 (Farrenkopf 1978)."""
    P, T = added(filter_of(gyro_bias_deg_h_sqrt_h=0.3), turning([0.0, 0.0, 0.0], 2.0)), 2.0
    q = 0.3 * DEG_PER_HOUR / SQRT_HOUR
    C_sg = some_values().C_sg
    expected = np.zeros((16, 16))
    expected[THETA, THETA] = np.eye(3) * q**2 * T**3 / 3.0
    expected[EPSILON, EPSILON] = np.eye(3) * q**2 * T
    expected[THETA, EPSILON] = C_sg * q**2 * T**2 / 2.0
    expected[EPSILON, THETA] = expected[THETA, EPSILON].T
    assert_close(P, expected, 1e-12)


def test_walk_of_the_mounting_turns_the_tracker_with_it_and_not_the_gyros():
    P = added(filter_of(fixed_angles_arcsec_sqrt_h=10.0), turning([0.3, -0.2, 0.1], 2.0))
    q = 10.0 * ARCSEC / SQRT_HOUR
    for rows in (THETA, PSI):
        for columns in (THETA, PSI):
            np.testing.assert_allclose(P[rows, columns], np.eye(3) * q**2 * 2.0, rtol=0,
                                       atol=1e-12 * q**2)
    belief = Belief(some_values(), np.zeros(16), np.zeros((16, 16)))
    after = filter_of(fixed_angles_arcsec_sqrt_h=10.0).propagate(
        belief, turning([0.3, -0.2, 0.1], 2.0)[0])
    assert after.sigma[:3].max() < 1e-6 * q                 # phi: the gyros' own attitude


@pytest.mark.parametrize('seconds', [0.5, 10.0])
@pytest.mark.parametrize('walks', [{'gyro_bias_deg_h_sqrt_h': 0.3},
                                   {'fixed_angles_arcsec_sqrt_h': 10.0},
                                   {'gyro_bias_deg_h_sqrt_h': 0.3, 'k2_sqrt_h': 1e-7,
                                    'fixed_angles_arcsec_sqrt_h': 10.0}])
def test_one_interval_adds_what_many_short_ones_do(walks, seconds):
    """While g turns, wrong by a sixth of the turn at most, as the module says."""
    rate = np.radians(0.5) * np.array([0.6, -0.64, 0.48])   # of length one
    fine = added(filter_of(**walks), turning(rate, seconds, parts=round(seconds * 100)))
    coarse = added(filter_of(**walks), turning(rate, seconds))
    # and the rounding of up to 1000 steps
    assert_close(coarse, fine, np.radians(0.5) * seconds / 6.0 + 1e-10)


def test_walks_of_a_batch_are_those_of_its_runs():
    rng, q = np.random.default_rng(2), np.arange(1.0, 14.0)
    B, T = rng.normal(size=(4, 3, 3)), rng.uniform(0.1, 2.0, 4)
    batch = process_noise.root(q, B, T, 17)
    assert batch.shape == (4, 17, 16)
    for k in range(4):
        np.testing.assert_array_equal(batch[k], process_noise.root(q, B[k], T[k], 17))
    assert not batch[:, 16].any()


# What it is for


class Walking:
    """A run of which one kind of state walks, from a truth drawn from the initial sigmas."""

    def __init__(self, name, density, seconds, seed, modelled=True):
        scenario = TAN2018.replace({'simulation.duration_s': seconds, 'simulation.seed': seed,
                                    'estimator.answer_changes': False,
                                    **({GROUP + name: density} if modelled else {})})
        rng = np.random.default_rng([20180314, seed])
        self.calibrator = Calibrator(scenario)
        sigma = self.calibrator.filter.initial_sigma.copy()
        sigma[THETA] = 0.0                      # the attitude is found from the stars
        start = self.calibrator.filter.start.without(sigma * rng.normal(size=16))
        gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
        samples, simulated = gyro.next(gyro.count), tracker.truth
        states, unit = next((states, unit) for kind, states, unit in KINDS if kind == name)
        step = np.zeros(16)
        step[states] = density * unit / SQRT_HOUR       # in a second
        bias = start.bias + np.cumsum(
            0.1 * step[EPSILON] * rng.normal(size=samples.rate.shape), axis=0)
        truth, frames = replace(simulated, C_sg=start.C_sg, intrinsics=start.intrinsics), []
        while tracker.next_index < tracker.count:
            if frames:
                turn, lens = np.split(np.sqrt(0.5) * step[6:] * rng.normal(size=10), [3])
                truth = replace(truth, C_sg=rotation.exp(turn) @ truth.C_sg,
                                intrinsics=truth.intrinsics + lens)
            tracker.truth = truth
            frames.append(tracker.next(1))
        self.calibrator.add_gyro(GyroSamples(samples.stamp_ns,
                                             samples.rate - simulated.bias + bias))
        self.calibrator.add_frames(Frames.concatenate(frames))
        list(self.calibrator.process())
        stamp = np.array([self.calibrator.stamp_ns])
        last = np.searchsorted(samples.stamp_ns, stamp)[0]
        self.truth = Nominal(simulated.motion.attitude(stamp)[0].T, bias[last], truth.C_sg,
                             truth.intrinsics)

    @property
    def normalised(self):
        """Errors of the states in their own sigmas, the attitude that of the tracker."""
        belief = self.calibrator.belief
        error = belief.estimate.minus(self.truth)
        return error / np.concatenate((belief.tracker_sigma, belief.sigma[3:]))


# Large against what a run tells of the state, small against its initial sigma.
WALKS = [('gyro_bias_deg_h_sqrt_h', 0.3, EPSILON), ('fixed_angles_arcsec_sqrt_h', 120.0, PSI),
         ('principal_point_px_sqrt_h', 3.0, LENS)]


@pytest.mark.slow
@pytest.mark.parametrize('name, density, walking', WALKS, ids=[walk[0] for walk in WALKS])
def test_walk_that_the_filter_knows_of_does_no_harm(name, density, walking):
    """Without it the walking states are off by many sigma."""
    blind = Walking(name, density, 550.0, 1, modelled=False).normalised
    assert np.abs(blind[walking]).max() > 5.0
    errors = Walking(name, density, 550.0, 1).normalised
    assert [state for state, error in zip(STATE_NAMES, errors) if abs(error) > 3.5] == []


@pytest.mark.slow
@pytest.mark.parametrize('name, density', [walk[:2] for walk in WALKS])
def test_estimates_of_walking_states_are_consistent(name, density):
    """Mean NEES of 30 runs, through a rotation, in its 99.9 % chi-square interval."""
    runs = [Walking(name, density, 100.0, seed) for seed in range(30)]
    low, high = chi2.ppf([0.0005, 0.9995], 16 * len(runs)) / len(runs)
    assert low < np.mean([run.calibrator.belief.nees(run.truth) for run in runs]) < high
