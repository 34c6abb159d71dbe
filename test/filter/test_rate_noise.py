# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What goes with the rate is not drawn along by the noise of the gyro that tells it.

The noise of a reading is in the turn up to the frame as well: regressed on what was read, a time
offset or a scale factor of a coarse gyro is off by more sigmas the longer the run.
"""

from dataclasses import replace

import numpy as np
import pytest

from instruments import TAN2018, calibrated, failed
from starcal_ros.config import presets
from starcal_ros.core import rotation
from starcal_ros.core.kalman import Evidence
from starcal_ros.evaluation.estimation_error import nominal
from starcal_ros.filter import hypotheses
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.rate_noise import NoiseMoments
from starcal_ros.filter.states import EPSILON, N_STATES, SCALE, THETA
from starcal_ros.measurements.preintegration import preintegrate
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.results.result import word
from starcal_ros.simulation.truth import Truth

Q, T = 1e-5, 0.5                        # angular random walk [rad/sqrt(s)], interval [s]
RATE = np.array([0.02, -0.01, 0.03])
C_SG = rotation.exp(np.array([0.3, -1.2, 0.8]))
GYRO_MATRIX = {'estimator.augment.gyro_matrix_sigma_ppm': 1000.0}
FIRST = NoiseMoments(*np.zeros((2, 3, 3))).before(np.array(True), np.array(T))
TIME_OFFSET = {'estimator.augment.time_offset_sigma_s': 0.005}


def information(rng):
    """Return H (2 n, 16) of a frame and N of the turn, with nothing known before it."""
    H = rng.normal(size=(12, N_STATES))
    A = H[:, THETA] / SCALE[THETA]
    return H, A.T @ A


def test_the_scores_of_effects_have_the_mean_that_is_taken_off():
    """Of directions that are linear in the rate, and of the turn that the same noise makes."""
    H, N = information(np.random.default_rng(1))
    rng = np.random.default_rng(2)
    said = Evidence(np.zeros(12), H, np.zeros((12, N_STATES)), np.eye(N_STATES),
                    np.zeros((N_STATES, N_STATES)))
    sight = hypotheses.Sight(rng.normal(size=(6, 3)), rng.normal(size=(6, 2)), np.full(6, 5.0),
                             np.array([512.0, 512.0]))
    mean = np.zeros((len(hypotheses.HYPOTHESES), 3))
    for axis in np.eye(3):              # E[n n'] = q^2 / T, of which theta is - T C_sg n
        C_gi = rotation.exp(-1e-6 * axis * T)
        by_states = 1e6 * hypotheses.shift(
            np.eye(3), C_gi, C_SG, np.eye(3), T * np.eye(3), np.array(T), N_STATES)
        by_states = by_states - 1e6 * hypotheses.shift(
            np.eye(3), np.eye(3), C_SG, np.eye(3), T * np.eye(3), np.array(T), N_STATES)
        itself = hypotheses.direct(said, np.eye(3), C_SG @ axis, sight) - hypotheses.direct(
            said, np.eye(3), np.zeros(3), sight)
        z = H[:, THETA] / SCALE[THETA] @ (-T * C_SG @ axis)
        mean += Q**2 / T * ((H @ by_states).T @ z + itself.T @ z).reshape(mean.shape)
    told = hypotheses.drawn(N, C_SG, np.array([Q**2, Q**2 * T]))
    assert np.count_nonzero(told) == 7
    np.testing.assert_allclose(told, mean, rtol=1e-5, atol=1e-9 * np.abs(mean).max())


@pytest.mark.parametrize('optional', [GYRO_MATRIX, TIME_OFFSET])
def test_the_scores_of_optional_states_have_the_mean_that_is_taken_off(optional):
    """By differences of what the filter makes of readings, one axis at a time."""
    filter_ = Filter(TAN2018.replace(optional))
    start = filter_.begin(np.eye(3))
    belief = replace(start, nominal=replace(start.nominal, C_sg=C_SG))
    _, N = information(np.random.default_rng(3))
    stamps = np.arange(51) * 10_000_000

    def slopes(rate):
        """Return by what each optional state and each bias turns the prediction of a frame."""
        turn = preintegrate(GyroSamples(stamps, np.tile(rate, (51, 1))), stamps[[0, -1]],
                            np.zeros(3), 1e7, filter_.augmentation.needs_matrix).take(0)
        after, Phi = filter_.propagated(belief, turn)
        Phi = Phi * filter_.scale[:, None] / filter_.scale
        _, _, looked = filter_.model.seen(after.nominal)
        return Phi[THETA, N_STATES:] + looked, Phi[THETA, EPSILON]

    rest, by_bias = slopes(RATE)
    mean = np.zeros(rest.shape[1])
    for axis in np.eye(3):
        moved, _ = slopes(RATE + 1e-4 * axis)
        # A reading that is too large is a bias that is too small.
        mean += (moved - rest).T / 1e-4 @ N @ (-by_bias @ axis) * Q**2 / T
    told = filter_.augmentation.drawn(
        Q**2 * N, np.array(T), FIRST, np.zeros(rest.shape[1])).score
    assert not told[:N_STATES].any()
    np.testing.assert_allclose(told[N_STATES:] / filter_.scale[N_STATES:], mean,
                               atol=0.02 * np.abs(mean).max())      # the turn over the interval


@pytest.mark.slow
@pytest.mark.parametrize('rate_hz', [2.0, 2.3])
def test_a_time_offset_behind_a_coarse_gyro_is_not_drawn_along(rate_hz):
    """At 2.3 Hz frames fall anywhere between two readings."""
    run = TAN2018.replace({'simulation.duration_s': 1200.0, 'gyro.arw_deg_sqrt_h': 0.15,
                           'star_tracker.rate_hz': rate_hz, **TIME_OFFSET})
    calibrator = calibrated(run)
    true = nominal(Truth.from_scenario(run), calibrator.stamp_ns, calibrator.filter.augmentation)
    error = calibrator.belief.estimate.minus(true)[N_STATES:]
    assert abs(error / calibrator.belief.augmented_sigma) < 3.5
    assert calibrator.belief.nees(true) < 50.0              # 1e-5 of 17
    assert failed(calibrator) == set()


@pytest.mark.slow
@pytest.mark.parametrize('name', ['fog', 'mems', 'cubesat'])
def test_a_right_model_of_each_class_of_instrument_is_not_doubted(name):
    run = presets.scenario(name).replace({'simulation.duration_s': 1800.0})
    calibrator = calibrated(run)
    assert failed(calibrator) == set() and word(calibrator) != 'inconsistent'
    true = nominal(Truth.from_scenario(run), calibrator.stamp_ns, calibrator.filter.augmentation)
    assert calibrator.belief.nees(true) < 65.0              # 1e-5 of 25


@pytest.mark.slow
@pytest.mark.parametrize('truth, told', [
    ({}, None), ({'truth.star_tracker.centroid_sigma_px': 0.15}, 'NIS of the rest'),
    ({'truth.gyro.arw_deg_sqrt_h': 3.0}, 'NIS of the turns')])
def test_frames_that_a_gyro_hardly_predicts_are_judged_all_the_same(truth, told):
    """A turn is uncertain by ten sigmas of a centroid in each frame."""
    stated = TAN2018.replace({'simulation.duration_s': 200.0, 'gyro.arw_deg_sqrt_h': 1.0})
    calibrator = calibrated(stated, stated.replace(truth))
    statistics = {each.name for each in calibrator.consistency.statistics()}
    assert 'NIS of the rest' in statistics and 'turns along the rate' in statistics
    assert told in failed(calibrator) if told else failed(calibrator) == set()


@pytest.mark.slow
def test_a_time_offset_that_only_noise_would_tell_is_said_to_be_so():
    """Slow turns, frames ten times a second: an EKF would hold the offset near zero, and be sure.

    With frames half as often, and gyros a tenth as noisy, stars tell it.
    """
    run = TAN2018.replace({
        'simulation.duration_s': 300.0, 'motion.rate_deg_s': 0.15, 'gyro.rate_hz': 50.0,
        'star_tracker.rate_hz': 10.0, 'gyro.arw_deg_sqrt_h': 0.15, **TIME_OFFSET,
        'truth.star_tracker.time_offset_s': 0.005})
    name = 'noise of the gyro in the optional states'
    assert name in failed(calibrated(run))
    told = run.replace({'star_tracker.rate_hz': 5.0, 'gyro.arw_deg_sqrt_h': 0.01})
    calibrator = calibrated(told)
    assert failed(calibrator) == set()
    assert name in {each.name for each in calibrator.consistency.statistics()}
    true = nominal(Truth.from_scenario(told), calibrator.stamp_ns, calibrator.filter.augmentation)
    assert calibrator.belief.nees(true) < 50.0


def test_an_optional_state_beyond_its_initial_sigma_contradicts_it():
    run = TAN2018.replace({'simulation.duration_s': 300.0, **TIME_OFFSET})
    late = run.replace({'truth.star_tracker.time_offset_s': 0.04})
    assert 'optional states in their initial sigmas' in failed(calibrated(run, late))
