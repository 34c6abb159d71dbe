# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The 16-state filter: signs, derivatives, identities."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import INTRINSICS, PITCH_MM, TAN2018
from starcal_ros.core import camera, rotation
from starcal_ros.core.units import ARCSEC, DEG, DEG_PER_HOUR
from starcal_ros.evaluation.batch_results import run_batch
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.filter.error_state import SIGMA_ACQUIRED, Filter
from starcal_ros.filter.states import (CALIBRATED, EPSILON, LENS, N_STATES, PHI, PSI, SCALE,
                                       STATE_NAMES, STATE_UNITS, THETA, UNIT)
from starcal_ros.measurements.preintegration import Preintegrated, preintegrate
from starcal_ros.measurements.samples import GyroSamples, Stars
from starcal_ros.simulation import star_images
from starcal_ros.simulation.errors import smear

FILTER = Filter(TAN2018)
OPEN_LOOP = Filter(TAN2018.replace({'estimator.feedback': False}))
QUIET = Filter(TAN2018.replace({'gyro.arw_deg_sqrt_h': 0.0}))
PERIOD_NS = 10**7
# What the finite differences step by; THETA and PSI small against their own curvature.
STEP = np.array([*(1e-6,) * 3, *(1e-7,) * 3, *(1e-6,) * 3, 1.0, 1.0, 1e-3, 1e-4, 1e-6, 1e-4, 1e-4])


def some_values(seed=1, batch=()):
    """Return values with nothing zero."""
    rng = np.random.default_rng(seed)
    return Nominal(rotation.exp(rng.normal(size=(*batch, 3))),
                   1e-7 * rng.normal(size=(*batch, 3)),
                   rotation.exp(rng.normal(size=(*batch, 3))),
                   INTRINSICS * rng.uniform(0.95, 1.05, (*batch, 7)))


def some_root(seed=2, batch=()):
    """Return the root of a covariance of large correlations, in units of SCALE."""
    return 10.0 * np.random.default_rng(seed).normal(size=(*batch, N_STATES, N_STATES))


def directions(nominal, n=12, seed=3):
    """Return places, in i, of stars spread over the detector."""
    tangents = np.random.default_rng(seed).uniform(-0.12, 0.12, (n, 2))
    r_s = np.column_stack((tangents, np.ones(n)))
    return r_s / np.linalg.norm(r_s, axis=-1, keepdims=True) @ nominal.C_si


def stars_of(nominal, n=12, seed=3, sigma=0.05, batch=()):
    """Return a frame with centroid noise that these values would measure."""
    rng = np.random.default_rng(seed + 100)
    u_i = directions(nominal, n, seed)
    uv, _, _ = FILTER.model.predict(nominal, u_i)
    return Stars(u_i, uv + sigma * rng.normal(size=uv.shape), np.full((*batch, n), sigma))


def turning(seconds=2.0, seed=4):
    """Return the gyro's account of a turn by some 40 degrees about a moving axis."""
    n = round(seconds * 100)
    t = np.arange(1, n + 1)[:, None] / 100.0
    rate = 0.35 * np.cos(t * [1.0, 2.0, 3.0] + np.random.default_rng(seed).normal(size=3))
    gyro = GyroSamples(np.arange(1, n + 1) * PERIOD_NS, rate)
    return gyro, preintegrate(gyro, np.array([0, n * PERIOD_NS]), FILTER.start.bias, PERIOD_NS)


def one(batch, k=0):
    """Return one run of what preintegration or a batch returned."""
    return Preintegrated(*(part[k] for part in batch))


TURN = one(turning()[1])


def covariance_of_theta(belief):
    """Return the covariance with the attitude error counted as theta, in the filter's units."""
    root = SCALE[:, None] * belief.root
    return root @ np.swapaxes(root, -1, -2)


# The states


def test_states_are_those_of_T18_equation_21_each_with_a_unit_and_a_scale():
    assert len(STATE_NAMES) == len(STATE_UNITS) == len(UNIT) == len(SCALE) == N_STATES == 16
    slices = (PHI, EPSILON, PSI, LENS)
    assert np.hstack([np.arange(16)[part] for part in slices]).tolist() == list(range(16))
    assert STATE_NAMES[:9] == tuple(f'{name}_{axis}' for name in ('phi', 'epsilon', 'psi')
                                    for axis in 'xyz')
    assert STATE_NAMES[9:] == ('u0', 'v0', 'f', 'k1', 'k2', 'p1', 'p2')
    assert [STATE_UNITS[part] for part in slices] == [
        ('arcsec',) * 3, ('deg/h',) * 3, ('arcsec',) * 3,
        ('px', 'px', 'mm', 'mm^-2', 'mm^-4', 'mm^-1', 'mm^-1')]
    # 1 arcsec = pi / 648000 rad, 1 deg/h the same in rad/s
    np.testing.assert_allclose(UNIT[:9], np.pi / 648000, rtol=1e-15)
    np.testing.assert_array_equal(UNIT[9:], 1.0)


def test_filter_starts_from_the_nominal_values_and_initial_sigmas_of_the_scenario():
    scenario = TAN2018.replace({'gyro.bias_deg_h': (1.0, 2.0, 3.0),
                                'estimator.initial_sigma.focal_length_mm': 0.3})
    belief = Filter(scenario).begin(np.eye(3))
    np.testing.assert_allclose(belief.nominal.bias, np.array([1.0, 2.0, 3.0]) * DEG_PER_HOUR)
    np.testing.assert_array_equal(belief.nominal.intrinsics, [0, 0, 25.5, 0, 0, 0, 0])
    expected = [*(SIGMA_ACQUIRED,) * 3, *(0.1 * DEG_PER_HOUR,) * 3, *(600.0 * ARCSEC,) * 3,
                20.0, 20.0, 0.3, 1e-3, 1e-5, 1e-4, 1e-4]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance_of_theta(belief))), expected)


# Errors: their definition and their signs


def test_minus_gives_the_errors_that_T18_equations_7_and_8_define():
    """An estimate made by the two equations has their phi and Psi as its error."""
    rng, truth, size = np.random.default_rng(5), some_values(), 1e-6
    phi, psi = size * rng.normal(size=(2, 3))
    estimate = Nominal(truth.C_gi @ (np.eye(3) + rotation.skew(phi)), truth.bias + 3e-8,
                       (np.eye(3) + rotation.skew(psi)) @ truth.C_sg, truth.intrinsics + 0.5)
    error = estimate.minus(truth)
    second_order = 10.0 * size**2                   # size is a sigma; a 3-vector of it squared
    np.testing.assert_allclose(error[PSI], psi, rtol=0, atol=second_order)
    np.testing.assert_allclose(truth.C_si.T @ (error[THETA] - error[PSI]), phi, rtol=0,
                               atol=second_order)
    np.testing.assert_allclose(error[EPSILON], 3e-8, rtol=1e-7)
    np.testing.assert_allclose(error[LENS], 0.5, rtol=1e-12)


def test_without_takes_off_what_minus_finds():
    """Exact, for errors of any size."""
    estimate, truth = some_values(6), some_values(7)
    freed = estimate.without(estimate.minus(truth))
    for name in ('C_gi', 'bias', 'C_sg', 'intrinsics'):
        np.testing.assert_allclose(getattr(freed, name), getattr(truth, name), rtol=1e-12,
                                   atol=1e-14)


def test_minus_finds_what_without_took_off():
    estimate = some_values(6)
    error = 1e-3 * np.random.default_rng(8).normal(size=16)
    np.testing.assert_allclose(estimate.minus(estimate.without(error)), error, rtol=0, atol=1e-14)


def test_attitude_error_grows_by_plus_C_ig_epsilon():
    """DESIGN Sec. 3: phi' = +C_ig epsilon, epsilon = b_est - b; integrated with both biases."""
    gyro, _ = turning(0.5)
    truth = some_values()
    epsilon = np.array([1.0, -2.0, 3.0]) * 1e-6

    def attitude(bias):
        C_gi, history = truth.C_gi, []
        for rate in gyro.rate:
            C_gi = rotation.exp(-(rate - bias) * 0.01) @ C_gi
            history.append(C_gi)
        return np.array([truth.C_gi, *history])

    C_gi = attitude(truth.bias)
    phi = rotation.log(np.swapaxes(C_gi, -1, -2) @ attitude(truth.bias + epsilon))     # Eq. 7
    middle = 0.5 * (C_gi[1:] + C_gi[:-1])
    expected = np.swapaxes(middle, -1, -2) @ epsilon
    # the rate 0.6 rad/s over 0.01 s: curvature (0.006)^2 / 8 of 4e-6; phi at 1e-16 over 0.01 s
    np.testing.assert_allclose(np.diff(phi, axis=0) / 0.01, expected, rtol=0, atol=1e-10)


def test_filter_carries_a_bias_error_as_integration_does():
    gyro, interval = turning(0.5)
    truth = some_values()
    epsilon = np.array([1.0, -2.0, 3.0]) * 1e-8
    for estimate in (truth, replace(truth, bias=truth.bias + epsilon)):
        C_gi = truth.C_gi
        for rate in gyro.rate:
            C_gi = rotation.exp(-(rate - estimate.bias) * 0.01) @ C_gi
        belief = FILTER.propagate(Belief(estimate, np.zeros(16), some_root()), one(interval))
        # first order in the difference 2e-7 rad/s to the reference bias over 0.5 s; 1e-14 left
        np.testing.assert_allclose(belief.nominal.C_gi, C_gi, rtol=0, atol=1e-13)


# Derivatives


@pytest.mark.parametrize('state', range(16), ids=STATE_NAMES)
def test_measurement_matrix_agrees_with_central_differences(state):
    """Estimate minus truth: an estimate freed of -h has h more error."""
    nominal, h = some_values(), STEP[state]
    axis = np.eye(16)[state]
    u_i = directions(nominal)
    _, H, ahead = FILTER.model.predict(nominal, u_i)
    more, less = (camera.project(u_i @ values.C_si.T, values.intrinsics, PITCH_MM)
                  for values in (nominal.without(-h * axis), nominal.without(h * axis)))
    assert ahead.all()
    # Rounding of C_si (2e-16 of f/d = 4e3 px, a few times) over 2 h; the cubic term of theta is
    # 4e3 h^2, of f 1e-10.
    np.testing.assert_allclose(H[..., state], (more - less) / (2 * h), rtol=1e-10,
                               atol=4e-12 / (2 * h))


@pytest.mark.parametrize('state', range(16), ids=STATE_NAMES)
def test_transition_agrees_with_central_differences(state):
    """Two values, apart by a small error, go through the same turn; their difference after it."""
    nominal, h = some_values(), STEP[state]
    axis = np.eye(16)[state]
    belief = Belief(nominal, axis, np.eye(16))
    column = QUIET.propagate(belief, TURN).error            # Phi e_k
    after = QUIET.propagate(belief, TURN).nominal
    more, less = (QUIET.propagate(replace(belief, nominal=values), TURN).nominal.minus(after)
                  for values in (nominal.without(-h * axis), nominal.without(h * axis)))
    # rounding of the rotations, 1e-15, over 2 h; the cubic term is h^2
    np.testing.assert_allclose(column, (more - less) / (2 * h), rtol=1e-6,
                               atol=4e-15 / (2 * h) + h**2)


def test_transition_has_all_blocks_of_equation_E1():
    """A turn by 40 degrees couples theta to itself, to Psi and to epsilon; the rest stays."""
    nominal = some_values()
    Phi = np.stack([QUIET.propagate(Belief(nominal, axis, np.eye(16)), TURN).error
                    for axis in np.eye(16)], axis=1)
    C_s1s0 = nominal.C_sg @ TURN.Delta @ nominal.C_sg.T
    # the bias correction of 1e-7 rad/s over 2 s turns Delta by 2e-7
    np.testing.assert_allclose(Phi[THETA, THETA], C_s1s0, rtol=0, atol=1e-6)
    np.testing.assert_allclose(Phi[THETA, PSI], np.eye(3) - C_s1s0, rtol=0, atol=1e-6)
    assert np.linalg.norm(Phi[THETA, PSI]) > 0.5            # 2 sqrt(2) sin(20 deg) = 0.97
    assert np.linalg.norm(Phi[THETA, EPSILON]) > 1.0        # about 2 s
    np.testing.assert_array_equal(Phi[CALIBRATED], np.eye(16)[CALIBRATED])
    np.testing.assert_array_equal(Phi[THETA, LENS], 0.0)


# Covariances


def test_propagated_covariance_is_Phi_P_Phi_plus_the_random_walk():
    belief = Belief(some_values(), np.zeros(16), some_root())
    Phi = np.stack([FILTER.propagate(replace(belief, error=axis), TURN).error
                    for axis in np.eye(16)], axis=1)
    expected = Phi @ covariance_of_theta(belief) @ Phi.T
    # T18's ARW, 0.001 deg/sqrt(h) for 2 s, each axis whatever the motion
    expected[THETA, THETA] += np.eye(3) * (0.001 * DEG / 60.0)**2 * 2.0
    after = covariance_of_theta(FILTER.propagate(belief, TURN))
    scale = np.outer(SCALE, SCALE)
    # entries of some 16 * 10^2, of a sum over 32 columns, in double precision
    np.testing.assert_allclose(after / scale, expected / scale, rtol=1e-12, atol=1e-9)


def test_silence_of_the_gyro_adds_the_turn_that_may_hide_in_it():
    belief = Belief(some_values(), np.zeros(16), some_root())
    silent = TURN._replace(gap_turn=np.float64(0.02))       # 0.2 s: t^2 / 2
    more = (covariance_of_theta(FILTER.propagate(belief, silent))
            - covariance_of_theta(FILTER.propagate(belief, TURN)))
    expected = np.zeros((16, 16))
    expected[THETA, THETA] = np.eye(3) * (1.0 * DEG * 0.02)**2      # 1 deg/s^2, the default
    scale = np.outer(SCALE, SCALE)
    np.testing.assert_allclose(more / scale, expected / scale, rtol=1e-9, atol=1e-9)


def test_covariance_counts_the_attitude_as_T18_does():
    """phi = C_is (theta - Psi), so P = T P_theta T' with that one linear map."""
    belief = Belief(some_values(), np.zeros(16), some_root())
    C_is = belief.nominal.C_si.T
    T = np.eye(16)
    T[PHI, THETA], T[PHI, PSI] = C_is, -C_is
    expected = T @ covariance_of_theta(belief) @ T.T
    scale = np.outer(SCALE, SCALE)
    np.testing.assert_allclose(belief.covariance / scale, expected / scale, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(belief.sigma, np.sqrt(np.diag(expected)), rtol=1e-12)
    np.testing.assert_allclose(belief.tracker_sigma,
                               np.sqrt(np.diag(covariance_of_theta(belief)))[THETA], rtol=1e-12)


def test_nees_is_the_error_weighted_with_the_inverse_covariance():
    truth, size = some_values(), 1e-7
    belief = Belief(truth.without(size * np.random.default_rng(9).normal(size=16)), np.zeros(16),
                    some_root())
    error = belief.nominal.minus(truth) / SCALE
    P = belief.root @ belief.root.T
    np.testing.assert_allclose(belief.nees(truth), error @ np.linalg.solve(P, error), rtol=1e-6)


def test_reacquired_belief_keeps_the_calibration_and_forgets_the_attitude():
    belief = Belief(some_values(), np.zeros(16), some_root())
    C_gi = rotation.exp(np.array([0.3, -0.2, 0.1]))
    found = FILTER.reacquired(belief, C_gi)
    np.testing.assert_array_equal(found.nominal.C_gi, C_gi)
    np.testing.assert_array_equal(found.nominal.intrinsics, belief.nominal.intrinsics)
    before, after = (covariance_of_theta(b) / np.outer(SCALE, SCALE) for b in (belief, found))
    np.testing.assert_allclose(after[CALIBRATED, CALIBRATED], before[CALIBRATED, CALIBRATED],
                               rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(after[THETA, CALIBRATED], 0.0)
    np.testing.assert_allclose(found.tracker_sigma, 1.0 * DEG, rtol=1e-12)


# The update


@pytest.mark.parametrize('filter_', [FILTER, OPEN_LOOP], ids=['feedback', 'open loop'])
def test_update_is_the_textbook_Kalman_update(filter_):
    """Dense x = K z, P+ = (I - K H) P, z' S^-1 z, against the square-root form."""
    truth = some_values()
    belief = Belief(truth.without(1e-6 * np.ones(16)), 1e-6 * SCALE * np.arange(16),
                    0.1 * some_root())
    frame = stars_of(truth)
    uv, H, _ = filter_.model.predict(belief.nominal, frame.u_i)
    H = (H * SCALE).reshape(-1, 16)
    P, error = belief.root @ belief.root.T, belief.error / SCALE
    z = (uv - frame.uv).ravel() - H @ error
    S = H @ P @ H.T + 0.05**2 * np.eye(24)
    error = error + P @ H.T @ np.linalg.solve(S, z)
    P_after = P - P @ H.T @ np.linalg.solve(S, H @ P)
    update = filter_.update(belief, frame, gated=False)
    # S has a condition of 1e9 or so: the dense form, not the other, loses digits
    np.testing.assert_allclose(update.nis, z @ np.linalg.solve(S, z), rtol=1e-5)
    np.testing.assert_allclose(update.belief.root @ update.belief.root.T, P_after, rtol=0,
                               atol=1e-6 * np.abs(P).max())
    found = update.belief.nominal.without(update.belief.error)
    expected = belief.nominal.without(SCALE * error)
    np.testing.assert_allclose(found.minus(expected) / SCALE, 0.0, atol=1e-6)
    assert (update.belief.error == 0.0).all() == (filter_ is FILTER)


SMEARED = Filter(TAN2018.replace({'star_tracker.smear': True, 'star_tracker.exposure_s': 0.2}))


def test_noise_of_a_star_grows_along_its_trail_as_the_simulated_one_does():
    """Projected at five instants of the exposure, at 1 deg/s about a skew axis."""
    nominal = replace(some_values(), reading=np.array([0.6, -0.5, 0.6]) * DEG)
    u_i, omega = directions(nominal), nominal.reading - nominal.bias
    turns = rotation.exp(-omega * (star_images.instants_ns(0.2) * np.array(1e-9))[:, None])
    uv = np.stack([FILTER.model.predict(replace(nominal, C_gi=turn @ nominal.C_gi), u_i)[0]
                   for turn in turns])
    G = smear.noise_factor(uv)
    assert (np.linalg.norm(G, axis=(1, 2)) > 4.0).all()
    _, H_s, _ = FILTER.model.predict(nominal, u_i)
    H_white, first = SMEARED.model.whitened(nominal, H_s, G[..., 0])
    _, second = SMEARED.model.whitened(nominal, H_s, G[..., 1])
    # the distortion bends and stretches a trail of 14 px by some 1e-3
    np.testing.assert_allclose(first, np.tile([1.0, 0.0], (12, 1)), atol=5e-3)
    np.testing.assert_allclose(second, np.tile([0.0, 1.0], (12, 1)), atol=5e-3)
    np.testing.assert_allclose(G @ H_white, H_s, rtol=0, atol=5e-3 * np.abs(H_s).max())


def test_without_a_rate_a_star_is_as_certain_as_its_sigma():
    truth = some_values()
    rest = replace(truth, reading=truth.bias)
    belief, frame = known(truth), stars_of(truth)
    expected = FILTER.update(belief, frame)
    instant = Filter(TAN2018.replace({'star_tracker.smear': True,
                                      'star_tracker.exposure_s': 0.0}))
    for update in (SMEARED.update(replace(belief, nominal=rest), frame),
                   instant.update(belief, frame)):
        np.testing.assert_array_equal(update.chi2, expected.chi2)
        np.testing.assert_array_equal(update.belief.root, expected.belief.root)


@pytest.mark.parametrize('filtered', [True, False])
def test_sigmas_are_true_while_stars_trail(filtered):
    """1 deg/s, 0.2 s: 14 px. The NEES of 16 states, 8 runs, by chance once in 1e4."""
    runs = run_batch(TAN2018.replace({
        'simulation.duration_s': 100.0, 'motion.rate_deg_s': 1.0, 'motion.dwell_s': 5.0,
        'star_tracker.exposure_s': 0.2, 'truth.star_tracker.smear': True,
        'star_tracker.smear': filtered}), range(1, 9))
    inside = chi2.ppf(5e-5, 128) < runs.nees[:, -1].sum() < chi2.isf(5e-5, 128)
    assert bool(inside) is filtered
    if filtered:
        assert np.sum(runs.nis) / np.sum(runs.nis_degrees) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize('settings', [
    {'camera.focal_length_mm': 4.0, 'camera.distortion': (-0.02, 2e-4, 1e-4, -1e-4)},
    {'camera.principal_point_px': (900.0, 0.0)}], ids=['strong barrel', 'far principal point'])
def test_stars_over_the_whole_detector_are_in_view(settings):
    """A pinhole with its axis in the middle ends before the corners of these."""
    filter_ = Filter(TAN2018.replace(settings))
    half = np.array([filter_.detector.width, filter_.detector.height]) / 2.0
    uv = half * np.stack(np.meshgrid(*2 * (np.linspace(-1.0, 1.0, 21),)), axis=-1).reshape(-1, 2)
    r_s = camera.unproject(uv, filter_.start.intrinsics, filter_.detector.pitch_mm)
    _, _, in_view = filter_.model.predict(filter_.start, r_s @ filter_.start.C_si)
    assert in_view.all()


def test_chi_square_of_a_star_is_its_innovation_in_units_of_its_own_covariance():
    truth = some_values()
    belief = Belief(truth, np.zeros(16), 0.01 * some_root())
    frame = stars_of(truth)
    uv, H, _ = FILTER.model.predict(truth, frame.u_i)
    update = FILTER.update(belief, frame)
    for k, z in enumerate(uv - frame.uv):
        S = H[k] @ covariance_of_theta(belief) @ H[k].T + 0.05**2 * np.eye(2)
        np.testing.assert_allclose(update.chi2[k], z @ np.linalg.solve(S, z), rtol=1e-8)


def test_gate_is_the_chi_square_quantile_of_two_degrees_of_freedom():
    np.testing.assert_allclose(FILTER.gate, -2.0 * np.log(1e-4), rtol=1e-12)    # exact for two


def known(truth):
    """Return a belief that knows everything to a thousandth of a pixel."""
    return Belief(truth, np.zeros(16), np.diag(np.full(16, 1e-6)))


def test_star_outside_the_gate_is_rejected_and_changes_nothing():
    truth, edge = some_values(), 0.05 * np.sqrt(FILTER.gate)
    clean = stars_of(truth)
    clean = clean._replace(uv=FILTER.model.predict(truth, clean.u_i)[0])
    for off, rejected in ((0.99 * edge, False), (1.01 * edge, True)):
        uv = clean.uv.copy()
        uv[4, 1] += off
        update = FILTER.update(known(truth), clean._replace(uv=uv))
        assert update.accepted.tolist() == [k != 4 or not rejected for k in range(12)]
    keep = np.arange(12) != 4
    without = FILTER.update(known(truth), clean.take(keep))
    np.testing.assert_allclose(update.belief.nominal.minus(without.belief.nominal), 0.0,
                               atol=1e-15)
    np.testing.assert_allclose(update.belief.root, without.belief.root, rtol=1e-12, atol=1e-18)
    # seen from values that the star did not move
    np.testing.assert_allclose(update.residual[4, 1], off, rtol=1e-9)


def test_ungated_update_uses_the_same_star():
    truth = some_values()
    frame = stars_of(truth)
    frame.uv[4] += 100.0
    assert FILTER.update(known(truth), frame, gated=False).accepted.all()


def test_star_behind_the_camera_is_not_used_and_gives_no_warning():
    truth = some_values()
    frame = stars_of(truth)
    frame.u_i[:3] = [-truth.C_si[2], truth.C_si[0], -frame.u_i[2]]      # behind, beside, behind
    with np.errstate(all='raise'):
        update = FILTER.update(known(truth), frame, gated=False)
    assert update.accepted.tolist() == [False] * 3 + [True] * 9
    without = FILTER.update(known(truth), Stars(*(part[3:] for part in frame)), gated=False)
    np.testing.assert_allclose(update.belief.nominal.minus(without.belief.nominal), 0.0,
                               atol=1e-15)
    np.testing.assert_allclose(update.nis, without.nis, rtol=1e-9)


@pytest.mark.parametrize('off_axis_deg', [25.0, 45.0, 75.0])
def test_star_far_outside_the_field_is_not_used_however_uncertain_the_lens(off_axis_deg):
    """Of a wrong number: there the polynomials of the lens may give any centroid at all."""
    truth = some_values()
    belief = Belief(truth, np.zeros(16), np.diag(FILTER.initial_sigma / SCALE))
    frame = stars_of(truth)
    angle = np.radians(off_axis_deg)
    frame.u_i[7] = np.array([np.sin(angle), 0.0, np.cos(angle)]) @ truth.C_si
    update = FILTER.update(belief, frame)
    assert np.flatnonzero(~update.accepted).tolist() == [7]


@pytest.mark.parametrize('toward', [(1.0, 0.0), (0.0, -1.0), (0.6, 0.8)])
def test_star_is_in_view_up_to_one_and_a_half_half_diagonals(toward):
    """1024 x 1024 pixels: 1.5 * 512 sqrt(2) of them, by the nominal camera, to a hundredth."""
    nominal, reach = some_values(), 1.5 * 512.0 * np.sqrt(2.0) * PITCH_MM / 25.5
    tangents = np.array([[0.98], [1.04]]) * reach * np.array(toward)
    u_i = np.column_stack((tangents, np.ones(2))) @ nominal.C_si
    assert FILTER.model.predict(nominal, u_i)[2].tolist() == [True, False]


def test_star_of_infinite_sigma_is_not_used_and_gives_no_warning():
    truth = some_values()
    frame = stars_of(truth)
    frame.sigma[5] = np.inf
    with np.errstate(all='raise'):
        update = FILTER.update(known(truth), frame)
    assert np.flatnonzero(~update.accepted).tolist() == [5]


def test_frame_without_stars_changes_nothing():
    belief = Belief(some_values(), np.zeros(16), some_root())
    update = FILTER.update(belief, Stars(np.empty((0, 3)), np.empty((0, 2)), np.empty(0)))
    np.testing.assert_allclose(update.belief.covariance, belief.covariance, rtol=1e-12)
    np.testing.assert_allclose(update.belief.nominal.minus(belief.nominal), 0.0, atol=1e-15)
    assert update.nis == 0.0


def test_feedback_and_open_loop_differ_in_second_order_only():
    """All errors and noises scaled by one half, the difference falls to one quarter."""
    rng = np.random.default_rng(11)
    sigma = np.array([*(100 * ARCSEC,) * 3, *(0.05 * DEG_PER_HOUR,) * 3, *(100 * ARCSEC,) * 3,
                      5.0, 5.0, 0.05, 1e-4, 1e-6, 1e-5, 1e-5])
    draw, noise = sigma * rng.normal(size=16), rng.normal(size=(4, 12, 2))
    start = some_values()

    def difference(scale):
        truth, found = start.without(scale * draw), []
        for filter_ in (FILTER, OPEN_LOOP):
            belief = Belief(start, np.zeros(16), np.diag(scale * sigma / SCALE))
            attitude = truth
            for k in range(4):
                u_i = directions(attitude, seed=k)
                uv, _, _ = FILTER.model.predict(attitude, u_i)
                frame = Stars(u_i, uv + 0.05 * scale * noise[k], np.full(12, 0.05 * scale))
                belief = filter_.update(belief, frame, gated=False).belief
                belief = filter_.propagate(belief, TURN)
                attitude = QUIET.propagate(replace(belief, nominal=attitude), TURN).nominal
            found.append(belief.estimate)
        return found[0].minus(found[1]) / sigma

    whole, half = difference(0.02), difference(0.01)
    assert np.linalg.norm(whole) > 1e-6                     # far above rounding, 1e-10
    # The next order is a fiftieth of this one, as the errors are of the prior that T18 takes.
    np.testing.assert_allclose(half, whole / 4.0, rtol=0, atol=0.1 * np.linalg.norm(whole))


# Batches


def runs(batch, k):
    """Return one run of a batched belief."""
    nominal = Nominal(*(getattr(batch.nominal, name)[k]
                        for name in ('C_gi', 'bias', 'C_sg', 'intrinsics')))
    return Belief(nominal, batch.error[k], batch.root[k])


@pytest.mark.parametrize('filter_', [FILTER, OPEN_LOOP], ids=['feedback', 'open loop'])
def test_batch_of_three_runs_equals_three_single_runs(filter_):
    start = Belief(some_values(batch=(3,)), np.zeros((3, 16)), 0.1 * some_root(batch=(3,)))
    turns = [turning(seed=k)[1] for k in range(3)]
    turn = Preintegrated(*(np.stack(parts) for parts in
                           zip(*(one(interval) for interval in turns))))
    frames = [stars_of(runs(start, k).nominal, seed=k) for k in range(3)]
    frame = Stars(*(np.stack(parts) for parts in zip(*frames)))
    updated = filter_.update(start, frame)
    after = filter_.propagate(updated.belief, turn)
    for k in range(3):
        single = filter_.update(runs(start, k), frames[k])
        np.testing.assert_array_equal(updated.accepted[k], single.accepted)
        for part in ('chi2', 'nis', 'residual'):
            # the sums of a batch may be taken in another order
            np.testing.assert_allclose(getattr(updated, part)[k], getattr(single, part),
                                       rtol=1e-8, atol=1e-9)
        expected = filter_.propagate(single.belief, one(turns[k]))
        found = runs(after, k)
        np.testing.assert_allclose(found.estimate.minus(expected.estimate) / SCALE, 0.0,
                                   atol=1e-8)
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-8)
        np.testing.assert_allclose(after.sigma[k], expected.sigma, rtol=1e-8)
        truth = some_values(seed=12)
        np.testing.assert_allclose(after.nees(truth)[k], expected.nees(truth), rtol=1e-6)


def test_batch_begins_propagates_and_is_updated_as_single_runs_are():
    """A Monte Carlo is the same code with an N in front, from the first attitude on."""
    C_gi = rotation.exp(np.random.default_rng(13).normal(size=(3, 3)))
    begun = FILTER.begin(C_gi)
    turn = Preintegrated(*(np.stack([part] * 3) for part in TURN))
    after = FILTER.propagate(begun, turn)
    for k in range(3):
        expected = FILTER.propagate(FILTER.begin(C_gi[k]), TURN)
        np.testing.assert_allclose(after.nominal.C_gi[k], expected.nominal.C_gi, atol=1e-14)
        np.testing.assert_allclose(after.covariance[k], expected.covariance, rtol=1e-10)


def test_batch_is_reacquired_as_single_runs_are():
    start = Belief(some_values(batch=(3,)), np.zeros((3, 16)), some_root(batch=(3,)))
    C_gi = rotation.exp(np.random.default_rng(14).normal(size=(3, 3)))
    found = FILTER.reacquired(start, C_gi)
    for k in range(3):
        expected = FILTER.reacquired(runs(start, k), C_gi[k])
        np.testing.assert_array_equal(found.nominal.C_gi[k], C_gi[k])
        np.testing.assert_allclose(covariance_of_theta(runs(found, k)),
                                   covariance_of_theta(expected), rtol=1e-12, atol=0)
