# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gyro matrix and time offset: derivatives, signs, and the bias that each removes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2
import yaml

from instruments import INTRINSICS, TAN2018
from starcal_ros.core import kalman, rotation
from starcal_ros.core.units import ARCSEC
from starcal_ros.filter import augmentation
from starcal_ros.filter.augmentation import NONE
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.gyro_matrix import sensitivity
from starcal_ros.filter.optional_state import Looked, OptionalState
from starcal_ros.filter.states import N_STATES, PHI, PSI, SCALE, STATE_NAMES, THETA
from starcal_ros.filter.verdict import judge
from starcal_ros.measurements.preintegration import Preintegrated, preintegrate
from starcal_ros.measurements.samples import GyroSamples, Stars
from starcal_ros.messages import conventions
from starcal_ros.results import export
from starcal_ros.results.result import result
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

MATRIX_ON = {'estimator.augment.gyro_matrix_sigma_ppm': 1000.0}
OFFSET_ON = {'estimator.augment.time_offset_sigma_s': 0.02}
BOTH_ON = {**MATRIX_ON, **OFFSET_ON}
FILTER = Filter(TAN2018.replace(BOTH_ON))
QUIET = Filter(TAN2018.replace({**BOTH_ON, 'gyro.arw_deg_sqrt_h': 0.0}))
PERIOD_NS = 10**7
NAMES = (*STATE_NAMES, *FILTER.augmentation.names)
MATRIX, AUGMENTED = slice(16, 25), slice(16, None)      # where they stand with both on
# What the finite differences step by, in the terms of the filter.
STEP = np.array([*(1e-6,) * 3, *(1e-7,) * 3, *(1e-6,) * 3, 1.0, 1.0, 1e-3, 1e-4, 1e-6, 1e-4, 1e-4,
                 *(1e-5,) * 9, 1e-4])


def some_values(seed=1, ppm=5000.0, batch=()):
    """Return values with nothing zero, M of thousands of ppm and tau of some 10 ms."""
    rng = np.random.default_rng(seed)
    augmented = np.concatenate((1e-6 * ppm * rng.normal(size=(*batch, 9)),
                                0.01 * rng.normal(size=(*batch, 1))), axis=-1)
    return Nominal(rotation.exp(rng.normal(size=(*batch, 3))),
                   1e-7 * rng.normal(size=(*batch, 3)),
                   rotation.exp(rng.normal(size=(*batch, 3))),
                   INTRINSICS * rng.uniform(0.95, 1.05, (*batch, 7)), augmented,
                   0.01 * rng.normal(size=(*batch, 3)), FILTER.augmentation)


def some_root(batch=()):
    return 10.0 * np.random.default_rng(2).normal(size=(*batch, 26, 26))


def turning(seed=4, seconds=0.5):
    """Return readings of a turn by some 10 degrees, in half a second, about a moving axis."""
    n = round(seconds * 100)
    t = np.arange(1, n + 1)[:, None] / 100.0
    rate = 0.35 * np.cos(t * [1.0, 2.0, 3.0] + np.random.default_rng(seed).normal(size=3))
    return GyroSamples(np.arange(1, n + 1) * PERIOD_NS, rate)


def interval(gyro, bias=FILTER.start.bias, with_matrix=True):
    cuts = np.array([0, gyro.stamp_ns[-1]])
    return Preintegrated(*(part[0] for part in preintegrate(
        gyro, cuts, bias, PERIOD_NS, with_matrix)))


TURN = interval(turning())


def places(nominal, n=12):
    """Return directions, in i, of stars spread over the detector."""
    tangents = np.random.default_rng(3).uniform(-0.12, 0.12, (n, 2))
    r_s = np.column_stack((tangents, np.ones(n)))
    return r_s / np.linalg.norm(r_s, axis=-1, keepdims=True) @ nominal.C_si


# The states


@pytest.mark.parametrize('options, m', [({}, 0), (OFFSET_ON, 1), (MATRIX_ON, 9), (BOTH_ON, 10)],
                         ids=['none', 'offset', 'matrix', 'both'])
def test_states_are_appended_where_their_sigma_is_given(options, m):
    filter_ = Filter(TAN2018.replace(options))
    belief = filter_.begin(np.eye(3))
    assert belief.root.shape == (16 + m, 16 + m)
    assert belief.nominal.augmented.tolist() == [0.0] * m
    expected = [1e-3] * (9 * bool(MATRIX_ON.keys() & options)) + [0.02] * bool(
        OFFSET_ON.keys() & options)
    np.testing.assert_allclose(belief.augmented_sigma, expected, rtol=1e-12)
    assert len(filter_.augmentation.names) == len(filter_.augmentation.units) == m
    assert filter_.augmentation.size == m and len(filter_.scale) == 16 + m
    assert belief.covariance.shape == belief.state_root.shape == (16, 16)
    assert belief.sigma.shape == (16,)


class Bowed(OptionalState):
    """A state that nobody has built in: the camera nods about x by a constant angle."""

    key = 'bow_sigma_arcsec'
    names = ('bow_arcsec',)
    unit = ARCSEC

    def looked(self, values, C_sg, rate_g):
        x = np.array([1.0, 0.0, 0.0])
        return Looked(rotation.exp(values * x), np.broadcast_to(
            x[:, None], (*values.shape[:-1], 3, 1)))


def test_a_further_state_is_one_entry(monkeypatch):
    """It has its sigma, its name, its column in H, against differences, beside the other two."""
    monkeypatch.setattr(augmentation, 'STATES', (*augmentation.STATES, Bowed()))
    on = augmentation.Augmentation.of(SimpleNamespace(
        gyro_matrix_sigma_ppm=1000.0, time_offset_sigma_s=0.02, pixel_phase_sigma_px=None,
        bow_sigma_arcsec=30.0))
    assert on.size == 11 and on.names[-2:] == ('tau_s', 'bow_arcsec') and on.units[-1] == ARCSEC
    values = replace(some_values(), augmentation=on, augmented=np.append(
        some_values().augmented, 20.0 * ARCSEC))
    u_i = places(values)
    uv, H, _ = FILTER.model.predict(values, u_i)
    assert H.shape == (12, 2, 27)
    for k, step in enumerate([*STEP, 1e-5]):
        error = step * np.eye(27)[k]
        numeric = (FILTER.model.predict(values.without(-error), u_i)[0]
                   - FILTER.model.predict(values.without(error), u_i)[0]) / (2.0 * step)
        if k in (0, 1, 2, *range(9, 16), 25, 26):       # what a frame depends on directly
            np.testing.assert_allclose(H[..., k], numeric, rtol=1e-5, atol=1e-5 * np.abs(
                numeric).max())
    error = values.minus(replace(values, augmented=np.zeros(11)))
    np.testing.assert_allclose(error[25:], values.augmented[9:], rtol=1e-12)


def test_covariance_of_the_16_is_the_marginal_one():
    belief = Belief(some_values(), np.zeros(26), some_root())
    whole = belief.whole_root @ belief.whole_root.T
    scale = np.outer(SCALE, SCALE)
    np.testing.assert_allclose(belief.covariance / scale, whole[:16, :16] / scale, rtol=1e-11,
                               atol=1e-8)
    np.testing.assert_allclose(belief.sigma, np.sqrt(np.diag(whole)[:16]), rtol=1e-12)
    np.testing.assert_allclose(belief.augmented_sigma, np.sqrt(np.diag(whole)[16:]), rtol=1e-12)
    state = conventions.state_vector(0, belief)
    assert len(state) == sum(size for _, size in conventions.STATE_LAYOUT)


def test_error_of_the_matrix_leaves_the_filter_as_the_error_of_M():
    """Rows of the root against finite differences of M by X (A.1)."""
    nominal, root = some_values(), np.zeros((26, 26))
    root[range(26), range(26)] = STEP / FILTER.scale
    whole = Belief(nominal, np.zeros(26), root).whole_root
    for k in range(16, 26):
        axis = STEP[k] * np.eye(26)[k]
        moved = nominal.without(-axis).augmented - nominal.without(axis).augmented
        # rounding of M, 2e-16, and the square of X
        np.testing.assert_allclose(whole[AUGMENTED, k], moved / 2.0, rtol=0, atol=1e-9 * STEP[k])


def test_without_takes_off_what_minus_finds():
    estimate, truth = some_values(6), some_values(7)
    error = estimate.minus(truth)
    assert error.shape == (26,)
    freed = estimate.without(error)
    np.testing.assert_allclose(freed.augmented, truth.augmented, rtol=0, atol=1e-14)
    np.testing.assert_allclose(freed.minus(truth), 0.0, atol=1e-13)
    assert freed.reading is estimate.reading


def test_a_turn_of_g_can_not_be_seen_wherever_the_estimate_is():
    """C_gi -> R C_gi, C_sg -> C_sg R', I + M -> (I + M) R': Psi = -sigma and X = -[sigma x]."""
    for seed in (1, 2):
        truth = some_values(seed)
        sigma = np.array([1e-6, -2e-6, 3e-6])
        R = rotation.exp(truth.C_sg.T @ sigma)
        M = sensitivity(truth.augmented[:9]) @ R.T - np.eye(3)
        turned = replace(truth, C_gi=R @ truth.C_gi, C_sg=truth.C_sg @ R.T,
                         augmented=np.append(M, truth.augmented[9]))
        error = turned.minus(truth)
        expected = np.zeros(26)
        expected[PSI], expected[MATRIX] = -sigma, -rotation.skew(sigma).ravel()
        np.testing.assert_allclose(error, expected, rtol=0, atol=1e-11)
        # Not by a turn either: what it does to the attitude of the tracker is nothing.
        after = QUIET.propagate(Belief(truth, expected, np.eye(26)), TURN)
        np.testing.assert_allclose(after.error[THETA], 0.0, atol=2e-2 * 1e-6 * 0.2)


# The gyro


def test_preintegration_by_the_matrix_agrees_with_central_differences():
    """The rate of g is (I + M)^-1 (omega_m - b); at M = 0."""
    gyro, bias, h = turning(), np.array([1e-3, -2e-3, 3e-3]), 1e-5

    def Delta(k, step):
        M = step * np.eye(9)[k].reshape(3, 3)
        rate = (gyro.rate - bias) @ np.linalg.inv(np.eye(3) + M).T
        return interval(GyroSamples(gyro.stamp_ns, rate), np.zeros(3)).Delta

    found = interval(gyro, bias)
    for k in range(9):
        less = rotation.log(found.Delta.T @ Delta(k, -h))
        more = rotation.log(found.Delta.T @ Delta(k, h))
        # rounding, a few 1e-16 for 50 products, over 2 h; the cubic term is (h turn)^2
        np.testing.assert_allclose(found.J[:, 3 + k], (more - less) / (2 * h), rtol=0, atol=1e-9)


def test_derivative_by_the_bias_is_the_same_with_and_without_the_matrix():
    plain = interval(turning(), with_matrix=False)
    np.testing.assert_array_equal(TURN.J[:, :3], plain.J)
    np.testing.assert_array_equal(TURN.Delta, plain.Delta)
    assert plain.J.shape == (3, 3)


def test_two_intervals_compose_to_the_whole():
    gyro = turning(seconds=1.0)
    a, b, c = 12_345_678, 500_000_000, 900_000_000
    parts = preintegrate(gyro, np.array([a, b, c]), np.zeros(3), PERIOD_NS, True)
    whole = preintegrate(gyro, np.array([a, c]), np.zeros(3), PERIOD_NS, True)
    np.testing.assert_allclose(whole.J[0], parts.J[0] + parts.Delta[0].T @ parts.J[1], rtol=0,
                               atol=1e-13)


def test_reading_is_that_of_the_interval_in_which_a_cut_falls():
    gyro = turning()
    cuts = np.array([0, 10 * PERIOD_NS, 10 * PERIOD_NS + 1, 11 * PERIOD_NS])
    found = preintegrate(gyro, cuts, np.zeros(3), PERIOD_NS).reading
    np.testing.assert_array_equal(found, gyro.rate[[9, 10, 10]])


def test_filter_integrates_with_the_matrix_as_the_gyro_model_says():
    """M of 5000 ppm, against integration with (I + M)^-1, for a turn of 10 degrees."""
    gyro, truth = turning(), some_values()
    G = np.linalg.inv(np.eye(3) + truth.augmented[:9].reshape(3, 3))
    expected = interval(GyroSamples(gyro.stamp_ns, (gyro.rate - truth.bias) @ G.T),
                        np.zeros(3)).Delta @ truth.C_gi
    after = FILTER.propagate(Belief(truth, np.zeros(26), some_root()), TURN).nominal
    turn = 0.5 * 0.35 * np.sqrt(3.0)
    np.testing.assert_allclose(after.C_gi, expected, rtol=0, atol=(0.02 * turn)**2)
    first_order = TURN.Delta @ rotation.exp(TURN.J[:, 3:] @ truth.augmented[:9]) @ truth.C_gi
    assert np.abs(first_order - expected).max() > 10.0 * np.abs(after.C_gi - expected).max()


def composed_for(nominal, gyro=turning()):
    """Return an interval composed for what is believed."""
    G = np.linalg.inv(np.eye(3) + nominal.augmented[:9].reshape(3, 3))
    return preintegrate(gyro, np.array([0, gyro.stamp_ns[-1]]), nominal.bias, PERIOD_NS, True,
                        G).take(0)


def test_minutes_without_stars_are_composed_for_the_present_bias_and_matrix():
    """5 minutes to and fro, M of 5000 ppm, 50 deg/h: to first order off by 10 arcsec."""
    t = np.arange(1, 6001)[:, None] / 20.0
    gyro = GyroSamples(np.arange(1, 6001) * 5 * 10**7,
                       0.02 * np.cos(t * [0.1, 0.2, 0.3] + [0.0, 1.0, 2.0]))
    truth = replace(some_values(), bias=np.array([2.0, -2.0, 1.0]) * 1e-4)
    cuts = np.array([0, gyro.stamp_ns[-1]])
    G = np.linalg.inv(np.eye(3) + truth.augmented[:9].reshape(3, 3))
    expected = preintegrate(GyroSamples(gyro.stamp_ns, (gyro.rate - truth.bias) @ G.T), cuts,
                            np.zeros(3), 5e7).Delta[0] @ truth.C_gi
    belief = Belief(truth, np.zeros(26), some_root())
    about_start = preintegrate(gyro, cuts, np.zeros(3), 5e7, True).take(0)
    assert FILTER.strays(truth, about_start)
    wrong = FILTER.propagate(belief, about_start).nominal.C_gi
    assert np.abs(wrong - expected).max() > 10.0 * ARCSEC
    assert FILTER.strays(truth, preintegrate(gyro, cuts, truth.bias, 5e7, True).take(0))
    whole = preintegrate(gyro, cuts, truth.bias, 5e7, True, G).take(0)
    assert not FILTER.strays(truth, whole) and not FILTER.strays(some_values(ppm=5.0), TURN)
    np.testing.assert_allclose(FILTER.propagate(belief, whole).nominal.C_gi, expected, rtol=0,
                               atol=1e-12)


@pytest.mark.parametrize('state', range(26), ids=NAMES)
def test_transition_agrees_where_the_reference_is_what_is_believed(state):
    nominal, h = some_values(), STEP[state]
    axis, turn = np.eye(26)[state], composed_for(some_values())
    column = QUIET.propagate(Belief(nominal, axis, np.eye(26)), turn).error
    after = QUIET.propagate(Belief(nominal, axis, np.eye(26)), turn).nominal
    more, less = (QUIET.propagate(Belief(values, axis, np.eye(26)), turn).nominal.minus(after)
                  for values in (nominal.without(-h * axis), nominal.without(h * axis)))
    np.testing.assert_allclose(column, (more - less) / (2 * h), rtol=2e-6,
                               atol=4e-15 / (2 * h) + h**2)


@pytest.mark.parametrize('state', range(26), ids=NAMES)
def test_transition_agrees_with_central_differences(state):
    """At M = 0 the reference is the present; there the derivatives are exact."""
    nominal, h = some_values(ppm=0.0), STEP[state]
    axis = np.eye(26)[state]
    belief = Belief(nominal, axis, np.eye(26))
    column = QUIET.propagate(belief, TURN).error
    after = QUIET.propagate(belief, TURN).nominal
    more, less = (QUIET.propagate(replace(belief, nominal=values), TURN).nominal.minus(after)
                  for values in (nominal.without(-h * axis), nominal.without(h * axis)))
    np.testing.assert_allclose(column, (more - less) / (2 * h), rtol=2e-6,
                               atol=4e-15 / (2 * h) + h**2)


@pytest.mark.parametrize('state', range(16, 25), ids=NAMES[16:25])
def test_transition_by_the_matrix_holds_where_it_is_not_zero(state):
    """Wrong by what J is of the correction, half of M times the turn: 0.5 * 0.02 * 0.3."""
    nominal, axis = some_values(), np.eye(26)[state]
    belief = Belief(nominal, axis, np.eye(26))
    column, after = (getattr(QUIET.propagate(belief, TURN), part) for part in ('error', 'nominal'))
    more, less = (QUIET.propagate(replace(belief, nominal=values), TURN).nominal.minus(after)
                  for values in (nominal.without(-1e-5 * axis), nominal.without(1e-5 * axis)))
    np.testing.assert_allclose(column, (more - less) / 2e-5, rtol=0, atol=0.003 * 0.3)
    np.testing.assert_allclose(np.delete(column, [0, 1, 2, state]), 0.0)


# The time offset


def test_frame_with_an_offset_is_predicted_as_the_sky_of_t_plus_tau():
    """At a constant rate: C_gi(t + tau) = exp(-[omega_g tau x]) C_gi(t), DESIGN Sec. 3."""
    nominal = some_values()
    tau = nominal.augmented[9]
    G = np.linalg.inv(np.eye(3) + nominal.augmented[:9].reshape(3, 3))
    omega_g = G @ (nominal.reading - nominal.bias)
    nominal = replace(nominal, steady=omega_g)
    later = replace(nominal, C_gi=rotation.exp(-omega_g * tau) @ nominal.C_gi,
                    augmented=np.append(nominal.augmented[:9], 0.0))
    u_i = places(nominal)
    found, expected = (FILTER.model.predict(values, u_i)[0] for values in (nominal, later))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert np.abs(found - FILTER.model.predict(
        replace(nominal, steady=np.zeros(3)), u_i)[0]).max() > 0.01       # 1e-5 rad: 0.04 px


@pytest.mark.parametrize('state', [0, 1, 2, *range(9, 26)], ids=lambda k: NAMES[k])
def test_measurement_matrix_agrees_with_central_differences(state):
    """All but what the module says it leaves out: of Psi, bias and M in omega_s tau."""
    nominal, h = some_values(), STEP[state]
    axis, u_i = np.eye(26)[state], places(nominal)
    _, H, _ = FILTER.model.predict(nominal, u_i)
    more, less = (FILTER.model.predict(values, u_i)[0]
                  for values in (nominal.without(-h * axis), nominal.without(h * axis)))
    omitted = 1.0 if MATRIX.start <= state < MATRIX.stop else 0.0     # f / d = 4e3 of 1e-4
    np.testing.assert_allclose(H[..., state], (more - less) / (2 * h), rtol=1e-9,
                               atol=4e-12 / (2 * h) + omitted)


# Batches, and the attitude found afresh


def test_batch_of_three_runs_equals_three_single_runs():
    one_by_one = [some_values(seed=k, ppm=500.0) for k in range(3)]
    nominal = replace(Nominal.stacked(one_by_one), by_noise=np.zeros((3, 10)))
    start = Belief(nominal, np.zeros((3, 26)), 0.1 * some_root((3,)))
    turns = [interval(turning(seed)) for seed in range(3)]

    def one(k):
        return Belief(nominal.of_run(k), start.error[k], start.root[k])

    u_i = np.stack([places(one(k).nominal) for k in range(3)])
    uv, _, _ = FILTER.model.predict(nominal, u_i)
    frame = Stars(u_i, uv + 0.05 * np.random.default_rng(5).normal(size=uv.shape),
                  np.full((3, 12), 0.05))
    turn = Preintegrated(*(np.stack(parts) for parts in zip(*turns)))
    after = FILTER.propagate(FILTER.update(start, frame, gated=False).belief, turn)
    for k in range(3):
        single = FILTER.update(one(k), frame.take(k), gated=False).belief
        expected = FILTER.propagate(single, turns[k])
        np.testing.assert_allclose(after.nominal.augmented[k], expected.nominal.augmented, rtol=0,
                                   atol=1e-12)
        np.testing.assert_allclose(after.nominal.C_gi[k], expected.nominal.C_gi, atol=1e-12)
        np.testing.assert_allclose(after.sigma[k], expected.sigma, rtol=1e-8)
        np.testing.assert_allclose(after.augmented_sigma[k], expected.augmented_sigma, rtol=1e-8)


def test_stacked_runs_are_the_batch_they_are_of():
    values = [some_values(seed=k) for k in range(3)]
    stacked = Nominal.stacked(values)
    for part in ('C_gi', 'bias', 'C_sg', 'intrinsics', 'augmented', 'reading'):
        np.testing.assert_array_equal(getattr(stacked, part), [getattr(v, part) for v in values])
    assert stacked.augmentation is FILTER.augmentation


def test_reacquired_belief_keeps_what_is_augmented():
    belief = Belief(some_values(), np.zeros(26), some_root())
    found = FILTER.reacquired(belief, np.eye(3))
    np.testing.assert_array_equal(found.nominal.augmented, belief.nominal.augmented)
    before, after = (b.root[3:] @ b.root[3:].T for b in (belief, found))
    np.testing.assert_allclose(after, before, rtol=1e-11, atol=1e-8)


def test_belief_of_the_16_alone_goes_through_the_same_filter():
    """What looks ahead for T18's states takes their marginal covariance with it."""
    nominal = some_values()
    belief = Belief(replace(nominal, augmented=np.empty(0), augmentation=NONE), np.zeros(16),
                    kalman.marginal(some_root(), 16))
    turn, u_i = interval(turning(), with_matrix=False), places(nominal)
    frame = Stars(u_i, FILTER.model.predict(belief.nominal, u_i)[0], np.full(12, 0.05))
    plain = Filter(TAN2018)
    for step in (lambda filter_: filter_.propagate(belief, turn),
                 lambda filter_: filter_.update(belief, frame).belief):
        np.testing.assert_array_equal(step(FILTER).root, step(plain).root)


# What they are for


class Run:
    """A simulation with M and tau, and what a filter of some options makes of it."""

    def __init__(self, options, seconds, ppm=0.0, tau=0.0, seed=1, draw=False):
        scenario = TAN2018.replace({'simulation.duration_s': seconds, 'simulation.seed': seed,
                                    **options})
        rng = np.random.default_rng([3106, seed])
        self.calibrator = Calibrator(scenario)
        filter_, gyro, tracker = self.calibrator.filter, *(
            make(scenario) for make in (sensors.gyro, sensors.star_tracker))
        simulated = tracker.truth
        self.motion = simulated.motion
        M = 1e-6 * ppm * rng.normal(size=(3, 3))
        true = Nominal(np.eye(3), simulated.bias, simulated.C_sg, simulated.intrinsics,
                       np.array([*M.ravel()[:9 * bool(MATRIX_ON.keys() & options)],
                                 *[tau] * bool(OFFSET_ON.keys() & options)]),
                       augmentation=filter_.augmentation)
        if draw:
            sigma = filter_.initial_sigma.copy()
            sigma[THETA] = 0.0                  # the attitude is found from the stars
            true = filter_.start.without(sigma * rng.normal(size=len(sigma)))
            M, tau = true.augmented[:9].reshape(3, 3), float(true.augmented[9])
        # A frame stamped t shows the motion of t + tau: as if that had begun earlier by tau.
        tracker.truth = replace(
            simulated, C_sg=true.C_sg, intrinsics=true.intrinsics,
            motion=replace(self.motion, start_ns=self.motion.start_ns - round(1e9 * tau)))
        samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
        rate = samples.rate - simulated.bias
        self.calibrator.add_gyro(GyroSamples(samples.stamp_ns, rate + rate @ M.T + true.bias))
        self.calibrator.add_frames(frames[frames.stamp_ns.searchsorted(self.motion.start_ns):])
        self.tracks = [frame.track for frame in self.calibrator.process(tracked=True)]
        self.truth = replace(true, C_gi=self.C_gi(self.calibrator.stamp_ns))

    def C_gi(self, stamps_ns):
        """Return the true attitude at stamps."""
        C_ig = self.motion.attitude(np.atleast_1d(stamps_ns))
        return np.swapaxes(C_ig, -1, -2).reshape(*np.shape(stamps_ns), 3, 3)

    @property
    def normalised(self):
        """Errors of all states in their own sigmas, those of attitude and M as the filter's."""
        belief = self.calibrator.belief
        sigma = self.calibrator.filter.scale * np.linalg.norm(belief.root, axis=-1)
        return belief.estimate.minus(self.truth) / sigma


@pytest.fixture(scope='module')
def scaled():
    """Return a run of 550 s, one cycle of T18's motion, its M of 1000 ppm known of."""
    return Run(MATRIX_ON, 550.0, ppm=1000.0)


@pytest.fixture(scope='module')
def late():
    """Return a run of 550 s, its time offset known of."""
    return Run(OFFSET_ON, 550.0, tau=0.01)


def test_gyro_matrix_removes_the_bias_that_it_is_for(scaled):
    blind = Run({}, 550.0, ppm=1000.0)
    assert np.abs(blind.normalised[3:]).max() > 20.0
    assert [name for name, error in zip(NAMES, scaled.normalised) if abs(error) > 3.5] == []
    assert scaled.calibrator.counts.rejected_stars < 10 < blind.calibrator.counts.rejected_stars


def test_scale_factors_and_symmetric_part_are_found(scaled):
    """To some ppm of 1000; the antisymmetric part is told by the initial sigmas alone."""
    belief = scaled.calibrator.belief
    root = belief.whole_root[MATRIX].reshape(3, 3, -1)
    error = (belief.estimate.augmented - scaled.truth.augmented).reshape(3, 3)
    for sign, seen in ((1.0, True), (-1.0, False)):
        part = 0.5 * (error + sign * error.T)
        sigma = np.linalg.norm(0.5 * (root + sign * root.swapaxes(0, 1)), axis=-1)
        kept = np.triu_indices(3, 0 if seen else 1)
        assert (np.abs(part[kept]) < 3.5 * sigma[kept]).all()
        assert ((sigma[kept] < 10e-6) == seen).all()


@pytest.mark.slow
@pytest.mark.parametrize('tau', [0.01, -0.01])
def test_time_offset_removes_the_bias_that_it_is_for(tau, late):
    blind = Run({'estimator.answer_changes': False}, 550.0, tau=tau)
    assert np.abs(blind.normalised[3:]).max() > 3.5
    run = late if tau > 0.0 else Run(OFFSET_ON, 550.0, tau=tau)
    errors = run.normalised
    names = (*STATE_NAMES, *run.calibrator.filter.augmentation.names)
    assert [name for name, error in zip(names, errors) if abs(error) > 3.5] == []
    assert run.calibrator.belief.augmented_sigma[0] < 1e-4             # of 20 ms at first


@pytest.mark.slow
def test_estimates_of_all_26_states_are_consistent():
    """Mean NEES of 16 runs, through rotations about two axes, in its 99.9 % interval."""
    nees = []
    for seed in range(16):
        run = Run(BOTH_ON, 200.0, seed=seed, draw=True)
        nees.append(run.calibrator.belief.nees(run.truth))
    low, high = chi2.ppf([0.0005, 0.9995], 26 * len(nees)) / len(nees)
    assert low < np.mean(nees) < high


def test_attitude_between_frames_is_integrated_with_the_matrix(scaled):
    """The last second of a slew; its rate, 0.5 deg/s, times 1000 ppm is 0.9 arcsec in 0.5 s."""
    track = scaled.tracks[160]                  # from 79.5 s, in the first slew
    C_gi = scaled.C_gi(track.stamp_ns)
    phi = rotation.log(np.swapaxes(C_gi, -1, -2) @ track.C_gi)
    sigma = np.sqrt(np.diagonal(track.covariance, axis1=-2, axis2=-1))
    assert (np.abs(phi) < 4.0 * sigma).all()
    np.testing.assert_allclose(np.linalg.norm(track.rate, axis=-1), np.radians(0.5), rtol=1e-3)


def test_covariance_between_frames_is_that_of_the_filter():
    """What M adds is a tenth of the turn, 0.25 deg, and more: first order in that turn."""
    scenario = TAN2018.replace({**BOTH_ON, 'simulation.duration_s': 41.0})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator = Calibrator(scenario)
    samples = gyro.next(gyro.count)
    calibrator.add_gyro(samples)
    calibrator.add_frames(tracker.next(81))         # up to 40 s
    list(calibrator.process(tracked=True))
    track = calibrator.track()
    cuts = np.array([calibrator.stamp_ns, track.stamp_ns[-1]])
    turn = Preintegrated(*(part[0] for part in preintegrate(
        samples, cuts, calibrator.filter.start.bias, PERIOD_NS, True)))
    after = calibrator.filter.propagate(calibrator.belief, turn)
    np.testing.assert_allclose(track.covariance[-1], after.covariance[PHI, PHI], rtol=0,
                               atol=0.02 * np.diag(after.covariance)[PHI].max())
    stamp_ns, C_gi = calibrator.attitude_now()
    assert stamp_ns == cuts[1]
    np.testing.assert_allclose(C_gi, after.nominal.C_gi, rtol=0, atol=1e-9)


def test_open_loop_filter_finds_the_offset_too():
    run = Run({**OFFSET_ON, 'estimator.feedback': False}, 200.0, tau=0.01)
    tau = run.calibrator.belief.estimate.augmented[0]
    assert abs(tau - 0.01) < 0.001
    assert run.calibrator.belief.nominal.augmented[0] == 0.0


# The result


def test_result_holds_the_augmented_estimates(late, scaled):
    for run, names in ((late, ['tau_s']), (scaled, [
            f'M_{row}{column}_ppm' for row in 'xyz' for column in 'xyz'])):
        outcome = result(run.calibrator, {})
        assert np.shape(outcome['covariance']) == (N_STATES, N_STATES)
        assert outcome['augmented']['names'] == names
        unit = 1.0 if names == ['tau_s'] else 1e-6
        belief = run.calibrator.belief
        np.testing.assert_allclose(np.array(outcome['augmented']['estimates']) * unit,
                                   belief.estimate.augmented, rtol=1e-12)
        np.testing.assert_allclose(np.array(outcome['augmented']['sigmas']) * unit,
                                   belief.augmented_sigma, rtol=1e-12)


def test_result_says_nothing_of_states_that_are_off():
    assert 'augmented' not in result(Run({}, 30.0).calibrator, {})


def test_verdict_judges_the_16_states_of_an_augmented_filter():
    """Diagnostics and command ask for it in every run."""
    scenario = TAN2018.replace({'estimator.augment.gyro_matrix_sigma_ppm': 100.0,
                                'estimator.augment.time_offset_sigma_s': 0.01,
                                'simulation.duration_s': 5.0})
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(sensors.gyro(scenario).next(10**6))
    calibrator.add_frames(sensors.star_tracker(scenario).next(10**6))
    for _ in calibrator.process():
        pass
    assert len(judge(calibrator.filter, calibrator.belief).states) == 13


def test_a_stated_offset_is_taken_off_the_stamps():
    """Frames 250 ms late, of which it is known: bit for bit as frames without an offset."""
    late = TAN2018.replace({'simulation.duration_s': 20.0, 'star_tracker.time_offset_s': 0.25})
    gyro, tracker = sensors.gyro(late), sensors.star_tracker(late)      # these have it, too
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    early = replace(frames, stamp_ns=frames.stamp_ns - 250_000_000)
    known, unknown = (Calibrator(late), Calibrator(late.replace(
        {'star_tracker.time_offset_s': 0.0})))
    stamps = []
    for calibrator, given in ((known, frames), (unknown, early)):
        calibrator.add_gyro(samples)
        calibrator.add_frames(given)
        stamps.append([frame.stamp_ns for frame in calibrator.process()])
    assert stamps[0] == stamps[1] and len(stamps[0]) > 30
    np.testing.assert_array_equal(known.belief.root, unknown.belief.root)
    assert known.counts.rejected_stars == 0
    exported = export.files(result(known, {}), late)
    assert yaml.safe_load(exported['camchain.yaml'])['cam0']['timeshift_cam_imu'] == -0.25
    # What is not known of it is left to the state.
    truth = Truth.from_scenario(late.replace({'truth.star_tracker.time_offset_s': 0.26}))
    assert truth.time_offset == 0.26 and truth.unknown_offset == pytest.approx(0.01)
