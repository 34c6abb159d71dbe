# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The filter says the truth about its own error, and stands at the Cramér-Rao bound."""

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import TAN2018
from starcal_ros.config.parameter import ConfigError
from starcal_ros.core import camera, rotation
from starcal_ros.core.units import ARCSEC
from starcal_ros.evaluation import bounds, consistency, montecarlo
from starcal_ros.evaluation.augmented import true_values
from starcal_ros.evaluation.batch_results import run_batch
from starcal_ros.evaluation.bounds import cramer_rao
from starcal_ros.evaluation.estimation_error import TrueRuns
from starcal_ros.filter import arithmetic, reference
from starcal_ros.filter.acquisition import AcquisitionError
from starcal_ros.filter.augmentation import Augmentation
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.optional_state import OptionalState
from starcal_ros.filter.states import CALIBRATED, EPSILON, N_STATES, STATE_NAMES, UNIT
from starcal_ros.measurements.samples import Frames
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

# Once through the rotations, after which the initial sigmas count for nothing.
SCENARIO = TAN2018.replace({'simulation.duration_s': 550.0, 'simulation.seed': 1001})
RUNS = 40
PROBABILITY = 0.999


# The statistics


def test_interval_of_a_mean_is_that_of_the_table():
    """Chi-square of 100 degrees of freedom, 95 %: 74.222 and 129.561 (any table)."""
    low, high = consistency.mean_interval(4, 25, 0.95)
    assert low == pytest.approx(74.222 / 25, abs=1e-4)
    assert high == pytest.approx(129.561 / 25, abs=1e-4)


def test_interval_of_an_rms_is_the_root_of_that_of_the_mean_square():
    low, high = consistency.rms_interval(100, 0.95)
    assert (low**2 * 100, high**2 * 100) == pytest.approx((74.222, 129.561), abs=1e-3)


def test_gate_takes_its_part_of_the_nis():
    """Against numbers drawn: 0.99 keeps 1 - 0.0465 of the mean; 4 sigma of a million."""
    drawn = np.random.default_rng(0).chisquare(2, 10**6)
    kept = drawn[drawn < chi2.ppf(0.99, 2)]
    assert consistency.gated_nis(0.99) == pytest.approx(kept.mean() / 2.0, abs=4e-3)
    assert consistency.gated_nis(0.99) == pytest.approx(1.0 - 0.0465, abs=1e-4)
    assert consistency.gated_nis(1.0) == 1.0


# The bound


def test_bound_is_the_inverse_of_the_information_of_the_whole_written_out():
    """Three frames, dense, each column a difference of the whole model by one unknown."""
    scenario = SCENARIO.replace({'simulation.duration_s': 60.0, 'star_tracker.rate_hz': 0.05})
    filter_, truth = Filter(scenario), Truth.from_scenario(scenario)
    tracker = sensors.star_tracker(scenario)
    frames = tracker.next(3)
    u_i = apparent(scenario, frames)
    C_gi = np.swapaxes(truth.motion.attitude(frames.stamp_ns), -1, -2)
    dt = np.diff(frames.stamp_ns)[0] * 1e-9
    fine = np.linspace(0.0, dt, 20001)
    turned = [np.trapezoid(truth.motion.attitude(stamp + np.rint(fine * 1e9).astype(np.int64)),
                           fine, axis=0) for stamp in frames.stamp_ns[:-1]]

    def model(x):
        """Stars, gyro and prior, whitened, for errors x of three attitudes and 13 constants."""
        phi, (epsilon, psi, lens) = x[:9].reshape(3, 3), np.split(x[9:], [3, 6])
        out = []
        for k in range(3):
            rows = slice(frames.first[k], frames.first[k + 1])
            C_si = rotation.exp(psi) @ truth.C_sg @ C_gi[k] @ rotation.exp(phi[k])
            out.append(camera.project(u_i[rows] @ C_si.T, truth.intrinsics + lens,
                                      truth.detector.pitch_mm).ravel() / 0.05)
        for k in range(2):
            out.append((phi[k + 1] - phi[k] - turned[k] @ epsilon) / (filter_.walk * np.sqrt(dt)))
        return np.concatenate([*out, x[9:] / filter_.initial_sigma[CALIBRATED]])

    step = np.concatenate((np.full(9, 1e-7), 1e-3 * filter_.initial_sigma[CALIBRATED]))
    A = np.stack([(model(s) - model(-s)) / 2.0 for s in np.diag(step)], axis=1)
    dense = np.linalg.inv(A.T @ A) * np.outer(step, step)
    bound, = cramer_rao(filter_, truth, frames, u_i, [3])
    scale = np.sqrt(np.diag(dense)[6:])
    # of the quadrature (C_ig turns by 0.01 deg in a step) and the differences: 1e-5
    np.testing.assert_allclose(bound.covariance / np.outer(scale, scale),
                               dense[6:, 6:] / np.outer(scale, scale), atol=1e-4)


WALKING = {f'estimator.process_noise.{name}': size for name, size in {
    'gyro_bias_deg_h_sqrt_h': 50.0, 'fixed_angles_arcsec_sqrt_h': 300.0,
    'principal_point_px_sqrt_h': 10.0, 'focal_length_mm_sqrt_h': 0.1, 'k1_sqrt_h': 1e-3,
    'k2_sqrt_h': 1e-5, 'p1_sqrt_h': 1e-4, 'p2_sqrt_h': 1e-4}.items()}
AUGMENTED = {'estimator.augment.gyro_matrix_sigma_ppm': 300.0,
             'estimator.augment.time_offset_sigma_s': 0.01,
             'truth.gyro.scale_factor_ppm': (3000.0, -2000.0, 1000.0),
             'truth.gyro.misalignment_arcsec': (100.0, -200.0, 300.0, 100.0, -100.0, 200.0),
             'truth.star_tracker.time_offset_s': 0.004}


@pytest.mark.parametrize('arw', [0.001, 0.0])
def test_bound_of_states_that_walk_is_that_of_the_whole_written_out(arw):
    """Gauss and Markov: all states of three frames, 50 s apart, and ten that stay; dense.

    The walks are summed over 20,000 steps of an interval, and all columns of the stars are
    differences of the whole model.
    """
    scenario = SCENARIO.replace({'simulation.duration_s': 150.0, 'star_tracker.rate_hz': 0.02,
                                 'gyro.arw_deg_sqrt_h': arw, **WALKING, **AUGMENTED})
    filter_, truth = Filter(scenario), Truth.from_scenario(scenario)
    frames, unit = sensors.star_tracker(scenario).next(3), filter_.initial_sigma
    u_i = StarDirections(scenario).of(frames).u_i
    gain = np.linalg.inv(np.eye(3) + truth.gyro_matrix)

    def seen(k, x):
        """Return the stars of a frame for errors of its 16 states and of M, tau."""
        phi, psi, lens, tau = x[:3], x[6:9], x[9:16], x[25] - 0.004
        rows = slice(frames.first[k], frames.first[k + 1])
        middle = frames.stamp_ns[k:k + 1] + round(tau * 1e9)
        C_si = (rotation.exp(psi) @ truth.C_sg @ truth.motion.attitude(middle)[0].T
                @ rotation.exp(phi))
        return camera.project(u_i[rows] @ C_si.T, truth.intrinsics + lens,
                              truth.detector.pitch_mm).ravel() / 0.05

    rows = [np.zeros((13, 58)), np.zeros((10, 58))]         # states of three frames, M, tau
    rows[0][:, 3:16] = np.diag(1.0 / unit[3:16])
    rows[1][:, 48:] = np.diag(1.0 / unit[16:])
    step = np.concatenate((np.full(3, 1e-6), 1e-4 * unit[3:25], [1e-4]))
    for k in range(3):
        slope = np.stack([(seen(k, s) - seen(k, -s)) / (2.0 * s.max()) for s in np.diag(step)],
                         axis=1)
        rows.append(np.zeros((len(slope), 58)))
        rows[-1][:, 16 * k:16 * k + 16], rows[-1][:, 48:] = slope[:, :16], slope[:, 16:]
    for k in range(2):
        dt = 50.0 / 20_000
        edge = frames.stamp_ns[k] + np.rint(1e9 * dt * np.arange(20_001)).astype(np.int64)
        at_edge = truth.motion.attitude(edge)
        omega = rotation.log(np.swapaxes(at_edge[:-1], -1, -2) @ at_edge[1:]) / dt
        K = truth.motion.attitude((edge[:-1] + edge[1:]) // 2) @ gain
        to_end = dt * (np.cumsum(K[::-1], axis=0)[::-1] - 0.5 * K)
        noise = np.zeros((20_000, 16, 16))      # of each step, in phi and in the 13
        noise[:, :3, :3] = filter_.walk * np.sqrt(dt) * K
        noise[:, :3, 3:6] = to_end * filter_.density[0] * np.sqrt(dt)
        noise[:, range(3, 16), range(3, 16)] = filter_.density * np.sqrt(dt)
        Q = np.einsum('nij,nkj->ik', noise, noise)
        Phi = np.eye(16)
        Phi[:3, 3:6] = dt * K.sum(axis=0)
        by_M = dt * np.einsum('nij,nk->ijk', K, omega).reshape(3, 9)
        scale = np.sqrt(np.diag(Q))
        whiten = np.linalg.inv(np.linalg.cholesky(Q / np.outer(scale, scale))) / scale
        rows.append(np.zeros((16, 58)))
        rows[-1][:, 16 * k + 16:16 * k + 32] = whiten
        rows[-1][:, 16 * k:16 * k + 16] = -whiten @ Phi
        rows[-1][:, 48:57] = -whiten[:, :3] @ by_M
    A = np.concatenate(rows)
    Q, R = np.linalg.qr(A)
    asked = np.r_[32:58]
    root = np.linalg.inv(R)[asked]
    sigma = np.linalg.norm(root, axis=1)
    bound, = cramer_rao(filter_, truth, frames, u_i, [3])
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(bound.covariance / scale, root @ root.T / scale, atol=1e-4)
    # What one initial sigma more or less in the first error of a state moves.
    np.testing.assert_allclose(bound.root @ bound.prior / sigma[:, None],
                               root @ Q[:23].T / sigma[:, None], atol=1e-4)


def test_bound_of_states_that_hardly_walk_is_that_of_states_that_stay():
    slow = {key: 1e-8 * size for key, size in WALKING.items()}
    np.testing.assert_allclose(montecarlo.bound(SCENARIO.replace(slow)),
                               montecarlo.bound(SCENARIO), rtol=1e-6)


def test_nees_of_runs_that_begin_alike_has_the_moments_of_draws():
    """Estimates of three states by hand: one is seen, one half, one not at all."""
    prior = np.zeros((6, 3))
    prior[3:] = np.diag([0.0, np.sqrt(0.5), 1.0])
    first = np.array([5.0, 1.0, 2.0])
    bound = bounds.Bound(np.eye(6), prior)
    z = np.random.default_rng(3).standard_normal((10**6, 6))
    z[:, 3:] = np.sqrt([1.0, 0.5, 0.0]) * z[:, 3:] + prior[3:] @ first
    nees = np.sum(z**2, axis=1)
    mean, variance = bound.nees_moments(first)
    assert (mean, variance) == pytest.approx((nees.mean(), nees.var()), rel=0.01)
    np.testing.assert_allclose(bound.prior_part, [0.0, 0.0, 0.0, 0.0, 0.5, 1.0])


def test_matched_interval_of_a_chi_square_is_its_own():
    assert consistency.matched_interval(16.0, 32.0, 40, 0.95) == pytest.approx(
        consistency.mean_interval(16.0, 40, 0.95))


def test_bound_of_the_gyro_bias_is_the_random_walk_over_the_root_of_the_time():
    """With stars that cost nothing, DESIGN Sec. 7: ARW / sqrt(T)."""
    scenario = SCENARIO.replace({'star_tracker.centroid_sigma_px': 1e-3})
    sigma = montecarlo.bound(scenario)[EPSILON] / UNIT[EPSILON]
    np.testing.assert_allclose(sigma, 0.001 / np.sqrt(549.5 / 3600.0), rtol=0.01)


def test_bound_of_a_perfect_gyro_is_the_limit_of_ever_better_ones():
    """Down to 1e-5 deg/sqrt(h), which walks by 0.01 arcsec in the run."""
    perfect, good = (montecarlo.bound(SCENARIO.replace({'gyro.arw_deg_sqrt_h': arw}))
                     for arw in (0.0, 1e-5))
    np.testing.assert_allclose(good, perfect, rtol=0.02)
    assert (good >= perfect * (1.0 - 1e-6)).all()


def test_bounds_at_several_times_are_those_of_runs_of_these_lengths():
    both = bounds.after(SCENARIO, [200.0, 550.0])
    for duration_s, covariance in zip((200.0, 550.0), both):
        alone = montecarlo.bound(SCENARIO.replace({'simulation.duration_s': duration_s}))
        np.testing.assert_allclose(np.sqrt(np.diag(covariance)), alone, rtol=1e-9)


def apparent(scenario, frames: Frames):
    """Return the apparent places of the stars of frames."""
    return StarDirections(scenario).of(frames).u_i


# The filter


@pytest.fixture(scope='module')
def runs():
    return run_batch(SCENARIO, range(1001, 1001 + RUNS))


@pytest.fixture(scope='module')
def bound():
    return montecarlo.bound(SCENARIO)


def objections(runs, bound):
    return consistency.objections(runs.nees[:, -1], runs.nis, runs.nis_degrees,
                                  runs.error[:, -1], runs.sigma[:, -1], bound,
                                  SCENARIO.estimator.gate_probability, PROBABILITY)


def test_filter_is_consistent_and_at_the_bound(runs, bound):
    assert objections(runs, bound) == []


@pytest.mark.slow
@pytest.mark.parametrize('arw', [0.001, 0.0])
def test_filter_is_consistent_where_the_bias_walks_as_it_is_told(arw):
    """In the run by 0.4 deg/h, eight sigmas: each is judged by its own bias at the end."""
    scenario = SCENARIO.replace({'gyro.arw_deg_sqrt_h': arw,
                                 'truth.gyro.bias_random_walk_deg_h_sqrt_h': 1.0,
                                 'estimator.process_noise.gyro_bias_deg_h_sqrt_h': 1.0})
    runs = run_batch(scenario, range(1001, 1021))
    assert objections(runs, montecarlo.bound(scenario)) == []
    low, high = montecarlo.summarize(scenario, runs)['nees_interval_95']
    assert (low, high) == pytest.approx(consistency.mean_interval(16, 20, 0.95), rel=1e-3)


def test_each_run_is_judged_by_its_own_truth_at_the_stamp():
    scenario = SCENARIO.replace({'truth.gyro.bias_random_walk_deg_h_sqrt_h': 1.0,
                                 'truth.mounting_drift.sigma_arcsec': 10.0})
    true = TrueRuns.of(scenario, [4, 5])
    for row, seed in enumerate([4, 5]):
        truth = Truth.from_scenario(scenario.replace({'simulation.seed': seed}))
        stamp = truth.motion.start_ns + 300 * 10**9
        at = true.at(stamp)
        np.testing.assert_array_equal(at.bias[row], truth.bias_at(np.array([stamp]))[0])
        np.testing.assert_array_equal(at.C_si[row], truth.attitude_si(np.array([stamp]))[0])
    assert (at.bias[0] != at.bias[1]).all() and (at.bias != truth.bias).all()


def test_true_values_that_stay_are_those_of_one_run():
    true = TrueRuns.of(SCENARIO, [4, 5]).at(Truth.from_scenario(SCENARIO).motion.start_ns)
    assert true.bias.shape == (3,) and true.augmented.shape == (0,)


@pytest.fixture(scope='module')
def augmented():
    scenario = SCENARIO.replace(AUGMENTED)
    return scenario, run_batch(scenario, range(1001, 1021))


@pytest.mark.slow
def test_filter_with_all_optional_states_is_consistent(augmented):
    """26 degrees of freedom, of which what nothing shows, a turn of g, is not drawn."""
    scenario, runs = augmented
    assert runs.error.shape[2] == runs.sigma.shape[2] == 26
    best, = bounds.at(scenario, [scenario.simulation.duration_s])
    assert runs.nees[:, -1].mean() in montecarlo.nees_interval(scenario, best, 20)
    np.testing.assert_allclose(runs.sigma[:, -1].mean(axis=0), best.sigma, rtol=0.01)
    unseen = best.prior_part > 0.1
    assert np.flatnonzero(unseen[N_STATES:]).tolist() == [1, 2, 3, 5, 6, 7]
    low, high = consistency.rms_interval(20, 1.0 - (1.0 - PROBABILITY) / 26)
    ratio = np.sqrt(np.mean(runs.error[:, -1]**2, axis=0)) / best.sigma
    assert ((ratio > low) & (ratio < high))[~unseen].all()


@pytest.mark.slow
def test_filter_is_consistent_in_runs_whose_gyro_matrix_is_drawn():
    """What is not seen is then drawn as well, and NEES has its 26 degrees of freedom."""
    rng, nees = np.random.default_rng(7), []
    mounting = Truth.from_scenario(SCENARIO).C_sg
    for seed in range(8):
        psi = rng.normal(0.0, 600.0 * ARCSEC, 3)
        scale, across = rng.normal(0.0, 300e-6, 3), rng.normal(0.0, 300e-6, 6)
        scenario = SCENARIO.replace({
            **AUGMENTED, 'simulation.duration_s': 300.0,
            'mounting.quaternion_xyzw': tuple(
                rotation.to_quaternion(rotation.exp(psi) @ mounting).tolist()),
            'truth.gyro.scale_factor_ppm': tuple((scale / 1e-6).tolist()),
            'truth.gyro.misalignment_arcsec': tuple((across / ARCSEC).tolist())})
        nees.append(run_batch(scenario, [seed]).nees[0, -1])
    assert float(np.mean(nees)) in consistency.mean_interval(26, 8, PROBABILITY)


def test_state_that_nobody_can_judge_is_named():
    on = Augmentation((OptionalState(),))
    on.on[0].key = 'nod_sigma_arcsec'
    with pytest.raises(ConfigError, match='estimator.augment.nod_sigma_arcsec: can not be judged'):
        true_values(on, Truth.from_scenario(SCENARIO))


def test_summary_has_the_optional_states_by_their_names(augmented):
    scenario, runs = augmented
    summary = montecarlo.summarize(scenario, runs)
    states = summary['states']
    assert list(states) == [*STATE_NAMES, *Filter(scenario).augmentation.names]
    assert summary['nees_degrees'] == 26
    low, high = summary['nees_interval_95']
    assert low < summary['nees_mean'] < high
    assert states['tau_s']['unit'] == 's' and states['tau_s']['rms'] < 1e-4
    assert states['M_xx_ppm']['unit'] == 'ppm' and 1.0 < states['M_xx_ppm']['sigma'] < 10.0
    assert states['M_xy_ppm']['prior'] > 0.1 > states['M_xx_ppm']['prior']


def test_batch_gives_each_seed_what_a_single_stream_gives(runs):
    for row in (0, RUNS - 1):
        scenario = SCENARIO.replace({'simulation.seed': int(runs.seed[row])})
        calibrator = Calibrator(scenario)
        calibrator.add_gyro(sensors.gyro(scenario).next(10**6))
        calibrator.add_frames(sensors.star_tracker(scenario).next(10**6))
        results = list(calibrator.process())
        linear = [frame for frame in results if frame.linear]
        np.testing.assert_allclose(runs.sigma[row, -1], calibrator.belief.sigma, rtol=1e-9)
        bias = calibrator.belief.estimate.bias - Truth.from_scenario(scenario).bias
        np.testing.assert_allclose(runs.error[row, -1][EPSILON], bias, rtol=1e-6)
        assert 0 < len(results) - len(linear) < 200
        assert runs.nis[row] == pytest.approx(sum(frame.nis for frame in linear), rel=1e-9)
        assert runs.nis_degrees[row] == 2 * sum(frame.accepted.sum() for frame in linear)
        np.testing.assert_allclose(runs.reprojection_rms[row], calibrator.reprojection_rms_px,
                                   rtol=1e-9)


def wrong_Q(monkeypatch):
    init = Filter.__init__
    monkeypatch.setattr(Filter, '__init__', lambda self, scenario: (
        init(self, scenario), setattr(self, 'walk', self.walk * np.sqrt(1.2)))[0])


def wrong_R(monkeypatch):
    update = Filter.update
    monkeypatch.setattr(Filter, 'update', lambda self, belief, stars, **words: update(
        self, belief, stars._replace(sigma=stars.sigma * np.sqrt(1.2)), **words))


def wrong_slope(column):
    def wrong(monkeypatch):
        predict = reference.predict

        def predicted(*given):
            uv, H, in_view = predict(*given)
            H[..., column] *= 1.2
            return uv, H, in_view
        monkeypatch.setattr(reference, 'predict', predicted)
        monkeypatch.setattr(arithmetic, 'correct', reference.correct)       # which asks for it
    return wrong


def wrong_transition(monkeypatch):
    propagated = Filter.propagated
    monkeypatch.setattr(Filter, 'propagated', lambda self, belief, gyro: propagated(
        self, belief, gyro._replace(J=1.2 * gyro.J)))


@pytest.mark.slow
@pytest.mark.parametrize('wrong', [
    wrong_Q, wrong_R, wrong_transition, *(wrong_slope(k) for k in (9, 11, 12, 13, 14))],
    ids=['Q', 'R', 'transition', 'H u0', 'H f', 'H k1', 'H k2', 'H p1'])
def test_a_fifth_too_much_is_objected_to(monkeypatch, bound, wrong):
    """Q, R and each kind of Jacobian, wrong by 20 %: the test above is one that can fail."""
    wrong(monkeypatch)
    assert objections(run_batch(SCENARIO, range(1001, 1011)), bound)


def test_a_fifth_too_much_in_the_slope_of_the_attitude_gives_no_attitude(monkeypatch):
    """Of ten runs some do not even begin."""
    wrong_slope(0)(monkeypatch)
    with pytest.raises(AcquisitionError):
        run_batch(SCENARIO, range(1001, 1011))
