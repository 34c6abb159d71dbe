# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The filter says the truth about its own error, and stands at the Cramér-Rao bound."""

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import TAN2018
from starcal_ros.core import camera, rotation
from starcal_ros.evaluation import bounds, consistency, montecarlo
from starcal_ros.evaluation.batch import run_batch
from starcal_ros.evaluation.bounds import cramer_rao
from starcal_ros.filter.acquisition import AcquisitionError
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import CALIBRATED, EPSILON, UNIT
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
    np.testing.assert_allclose(bound / np.outer(scale, scale),
                               dense[6:, 6:] / np.outer(scale, scale), atol=1e-4)


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


def test_batch_gives_each_seed_what_a_single_stream_gives(runs):
    for row in (0, RUNS - 1):
        scenario = SCENARIO.replace({'simulation.seed': int(runs.seed[row])})
        calibrator = Calibrator(scenario)
        calibrator.add_gyro(sensors.gyro(scenario).next(10**6))
        calibrator.add_frames(sensors.star_tracker(scenario).next(10**6))
        nis = sum(frame.nis for frame in calibrator.process())
        np.testing.assert_allclose(runs.sigma[row, -1], calibrator.belief.sigma, rtol=1e-9)
        bias = calibrator.belief.estimate.bias - Truth.from_scenario(scenario).bias
        np.testing.assert_allclose(runs.error[row, -1][EPSILON], bias, rtol=1e-6)
        assert runs.nis[row] == pytest.approx(nis, rel=1e-9)
        assert runs.nis_degrees[row] == 2 * calibrator.counts.stars
        np.testing.assert_allclose(runs.reprojection_rms[row], calibrator.reprojection_rms_px,
                                   rtol=1e-9)


def wrong_Q(monkeypatch):
    init = Filter.__init__
    monkeypatch.setattr(Filter, '__init__', lambda self, scenario: (
        init(self, scenario), setattr(self, 'walk', self.walk * np.sqrt(1.2)))[0])


def wrong_R(monkeypatch):
    update = Filter.update
    monkeypatch.setattr(Filter, 'update', lambda self, belief, stars, gated=True: update(
        self, belief, stars._replace(sigma=stars.sigma * np.sqrt(1.2)), gated))


def wrong_slope(column):
    def wrong(monkeypatch):
        predict = Filter.predict_centroids

        def predicted(self, nominal, u_i):
            uv, H, in_view = predict(self, nominal, u_i)
            H[..., column] *= 1.2
            return uv, H, in_view
        monkeypatch.setattr(Filter, 'predict_centroids', predicted)
    return wrong


def wrong_transition(monkeypatch):
    propagate = Filter.propagate
    monkeypatch.setattr(Filter, 'propagate', lambda self, belief, gyro: propagate(
        self, belief, gyro._replace(J=1.2 * gyro.J)))


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
