# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Pixel phase as a state of the filter: its derivative, and the bias that it removes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import TAN2018
from starcal_ros.config.models import detector
from starcal_ros.core import camera, pixel_phase
from starcal_ros.filter import arithmetic, reference, verdict
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.hypotheses import HYPOTHESES, PHASE_U
from starcal_ros.filter.offline import calibrate
from starcal_ros.measurements.samples import Stars
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

ON = {'estimator.augment.pixel_phase_sigma_px': 0.1}
SCENARIO = TAN2018.replace({'simulation.duration_s': 900.0})
AMPLITUDE_PX, SIGMA_PX = 0.05, SCENARIO.star_tracker.centroid_sigma_px
INTRINSICS = slice(9, 16)


def test_waves_are_what_blurred_pixels_show():
    """The mean of the wave over what the true place may be."""
    rng = np.random.default_rng(1)
    true = rng.random((400_000, 2))
    measured = true + 0.1 * rng.standard_normal(true.shape)
    exact, seen = pixel_phase.waves(true), pixel_phase.waves(measured, 0.1)
    for axis in range(2):
        for column in (2 * axis, 2 * axis + 1):
            least = seen[:, axis, column] @ exact[:, axis, column] / np.sum(
                seen[:, axis, column]**2)
            assert least == pytest.approx(1.0, abs=0.01)
    assert not exact[:, 0, 2:].any() and not exact[:, 1, :2].any()


@pytest.fixture(scope='module')
def messages():
    """Return what the sensors say with an error of 0.05 px in the centroids, and the truth."""
    quiet = SCENARIO.replace({'star_tracker.centroid_sigma_px': 1e-4})
    gyro, tracker = sensors.gyro(quiet), sensors.star_tracker(quiet)
    frames = tracker.next(tracker.count)
    uv = frames.uv_raster
    uv = uv + SIGMA_PX * np.random.default_rng(3).standard_normal(uv.shape) - (
        AMPLITUDE_PX * np.sin(2.0 * np.pi * uv))
    return (gyro.next(gyro.count),
            replace(frames, uv_raster=uv, sigma=np.full(len(uv), SIGMA_PX)),
            Truth.from_scenario(SCENARIO))


def error_of(calibrator, truth):
    """Return the errors of the camera, in sigmas of all seven together."""
    belief = calibrator.belief
    error = (belief.estimate.intrinsics - truth.intrinsics)
    P = belief.covariance[INTRINSICS, INTRINSICS]
    return float(error @ np.linalg.solve(P, error)), np.abs(error) / np.sqrt(np.diag(P))


@pytest.fixture(scope='module')
def without(messages):
    return calibrate(messages[0], messages[1], SCENARIO)[0]


@pytest.fixture(scope='module')
def estimated(messages):
    return calibrate(messages[0], messages[1], SCENARIO.replace(ON))[0]


def test_the_error_of_the_pixels_is_removed(messages, without, estimated):
    before, off = error_of(without, messages[2])
    after, _ = error_of(estimated, messages[2])
    assert before > 3.0 * chi2.ppf(0.9999, 7) and off.max() > 5.0
    assert after < chi2.ppf(0.999, 7)
    belief = estimated.belief
    found, sigma = belief.estimate.augmented, belief.augmented_sigma
    assert np.abs((found - [-AMPLITUDE_PX, 0.0, -AMPLITUDE_PX, 0.0]) / sigma).max() < 4.5
    assert sigma.max() < 0.003


def test_the_tests_of_the_model_no_longer_object(without, estimated):
    name = HYPOTHESES[PHASE_U].name
    failed = {each.name for each in without.consistency.statistics() if not each.passed}
    assert name in failed and verdict.of(without).summary.startswith('inconsistent')
    assert not [each.name for each in estimated.consistency.statistics() if not each.passed]


def test_the_derivative_is_that_of_the_measured_centroids():
    """A frame that is displaced by the waves of some amplitudes gives these amplitudes."""
    filter_ = Filter(TAN2018.replace(ON))
    belief = filter_.begin(np.eye(3))
    root = belief.root.copy()
    root[:16, :16] *= 1e-6              # all else is known
    belief = replace(belief, root=root)
    rng = np.random.default_rng(2)
    middle = detector(TAN2018.camera).centre_raster
    uv = rng.uniform(-500.0, 500.0, (4000, 2))
    u_i = camera.unproject(uv, filter_.start.intrinsics,
                           TAN2018.camera.pixel_pitch_mm) @ belief.nominal.C_si
    true = np.array([0.03, -0.02, 0.01, 0.04])
    sigma = np.full(len(uv), 1e-3)
    measured = uv + pixel_phase.waves(uv + middle) @ true
    after = filter_.update(belief, Stars(u_i, measured, sigma), gated=False).belief
    np.testing.assert_allclose(after.estimate.augmented, true, atol=1e-3)


def test_a_star_that_is_not_used_displaces_nothing():
    filter_ = Filter(TAN2018.replace(ON))
    uv = np.array([[3.2, np.nan], [7.1, 8.4]])
    u_i = camera.unproject(np.array([[3.2, 5.0], [7.1, 8.4]]), filter_.start.intrinsics,
                           TAN2018.camera.pixel_pitch_mm)
    u_i[0] = [0.0, 0.0, -1.0]           # behind
    belief = replace(filter_.begin(np.eye(3)), root=1e-6 * np.eye(20))
    belief = replace(belief, nominal=replace(belief.nominal, C_sg=np.eye(3)))
    direct = filter_.model.displaced(belief, Stars(u_i, uv, np.array([np.inf, 0.05])))
    assert direct.shape == (2, 2, 4) and not direct[0].any() and direct[1].any()


def test_off_by_default_and_compiled_alike(messages):
    assert Filter(SCENARIO).augmentation.size == 0
    if arithmetic.COMPILED:
        few = messages[1].take(np.arange(len(messages[1])) < 40)
        found = calibrate(messages[0], few, SCENARIO.replace(ON))[0].belief
        with pytest.MonkeyPatch.context() as patch:
            for name in ('correct', 'propagate'):
                patch.setattr(arithmetic, name, getattr(reference, name))
            plain = calibrate(messages[0], few, SCENARIO.replace(ON))[0].belief
        np.testing.assert_allclose(found.estimate.augmented, plain.estimate.augmented,
                                   rtol=1e-6, atol=1e-9)
    assert replace(TAN2018.estimator.augment).pixel_phase_sigma_px is None
