# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The filter on single frames: its update, its screening of stars, its bookkeeping."""

from functools import partial
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import INTRINSICS, LENS, PITCH_MM
from starcal_ros.calibration import attitude_free, invariants
from starcal_ros.calibration.attitude_free import AttitudeFree, CameraBelief
from starcal_ros.calibration.methods import angular_distance, singular_value
from starcal_ros.config.models import observer
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera, rotation
from starcal_ros.measurements.samples import Frames, Stars
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places

NOMINAL = np.array([0.0, 0.0, 25.5, 0.0, 0.0, 0.0, 0.0])
INITIAL = np.array([20.0, 20.0, 0.2, 1e-3, 1e-5, 1e-4, 1e-4])
SIGMA = 0.05
GATE = float(chi2.ppf(0.9999, 2))
SVD = partial(singular_value.measure, model=4, chosen=(2, 3), full=True)
BOTH = pytest.mark.parametrize('measure', [angular_distance.full, SVD], ids=['angles', 'svd'])


def frame_of(n, rng, truth=INTRINSICS, runs=()):
    """Return a noisy frame of n stars at some attitude, once for each run."""
    uv = rng.uniform(-500.0, 500.0, (n, 2))
    u_i = camera.unproject(uv, truth, PITCH_MM) @ rotation.exp(rng.normal(size=3))
    return Stars(np.tile(u_i, (*runs, 1, 1)),
                 uv + SIGMA * rng.standard_normal((*runs, n, 2)), np.full((*runs, n), SIGMA))


def nees(belief, truth):
    whitened = np.linalg.solve(belief.root, (belief.parameters - truth)[..., None])
    return np.sum(whitened**2, axis=(-2, -1))


@BOTH
def test_filter_ends_where_it_says_from_far_away(measure):
    """100 runs from errors drawn from the prior; 40 frames of 15 stars each."""
    rng, runs = np.random.default_rng(1), 100
    belief = CameraBelief(INTRINSICS + INITIAL * rng.standard_normal((runs, 7)),
                          np.broadcast_to(np.diag(INITIAL), (runs, 7, 7)))
    for _ in range(40):
        belief = attitude_free.update(belief, frame_of(15, rng, runs=(runs,)), LENS, measure)
    low, high = chi2.ppf([0.0005, 0.9995], 7 * runs) / runs
    assert low < nees(belief, INTRINSICS).mean() < high


def test_update_is_the_least_squares_adjustment_of_a_frame_and_its_prior():
    """Gauss-Newton with the attitude as three more unknowns, to convergence."""
    rng = np.random.default_rng(2)
    stars = frame_of(15, rng)
    prior = CameraBelief(INTRINSICS + 0.3 * INITIAL * rng.standard_normal(7), np.diag(INITIAL))
    x = prior.parameters.copy()
    C_si = invariants.align(stars.u_i, camera.unproject(stars.uv, x, PITCH_MM), np.ones((15, 1)))
    for _ in range(20):
        uv, N, H = camera.linearize(stars.u_i @ C_si.T, x, PITCH_MM)
        A = np.concatenate((N, H), axis=-1).reshape(-1, 10) / SIGMA
        A = np.vstack((A, np.hstack((np.zeros((7, 3)), np.diag(1.0 / INITIAL)))))
        b = np.concatenate(((uv - stars.uv).ravel() / SIGMA, (x - prior.parameters) / INITIAL))
        step = np.linalg.lstsq(A, b, rcond=None)[0]
        C_si = rotation.exp(-step[:3]) @ C_si
        x = x - step[3:]
    covariance = np.linalg.inv(A.T @ A)[3:, 3:]
    fitted = attitude_free.update(prior, stars, LENS, angular_distance.full)
    sigma = np.sqrt(np.diag(covariance))
    # It stops after a step below 0.3 sigma, the next one being a tenth of that at most.
    np.testing.assert_allclose(fitted.sigma / sigma, 1.0, atol=0.03)
    np.testing.assert_allclose((fitted.parameters - x) / sigma, 0.0, atol=0.03)


def test_misfit_of_a_star_is_the_fall_of_the_sum_of_squares_without_it():
    rng = np.random.default_rng(3)
    stars = frame_of(9, rng)
    root, x = np.diag(1e-2 * INITIAL), INTRINSICS
    misfit = attitude_free._misfit(invariants.linearize(stars, x, LENS), root, np.zeros(7))

    def least(use):
        part = Stars(*(values[use] for values in stars))
        # the slopes of the whole frame: the fall is that of the linear problem
        r_s = invariants.linearize(stars, x, LENS).r_s[use]
        uv, N, H = camera.linearize(r_s, x, PITCH_MM)
        A = np.concatenate((N, H @ root), axis=-1).reshape(-1, 10) / SIGMA
        A = np.vstack((A, np.hstack((np.zeros((7, 3)), np.eye(7)))))
        b = np.concatenate(((uv - part.uv).ravel() / SIGMA, np.zeros(7)))
        return np.sum((b - A @ np.linalg.lstsq(A, b, rcond=None)[0])**2)

    everyone = np.arange(9)
    fall = [least(everyone) - least(everyone != k) for k in everyone]
    np.testing.assert_allclose(misfit, fall, rtol=1e-5)


@BOTH
@pytest.mark.parametrize('known', [1.0, 1e-3], ids=['at the start', 'converged'])
def test_wrong_stars_are_found_and_the_good_ones_kept(measure, known):
    rng = np.random.default_rng(4)
    for _ in range(10):
        stars = frame_of(16, rng)
        wrong = rng.choice(16, 3, replace=False)
        stars.u_i[wrong[:2]] = stars.u_i[wrong[1::-1]]          # two take each other's number
        stars.uv[wrong[2]] += [2.0, -1.0]                       # one is 45 sigmas off
        prior = CameraBelief(INTRINSICS + known * 0.5 * INITIAL * rng.standard_normal(7),
                             np.diag(known * INITIAL))
        belief, used = attitude_free.screen(prior, stars, LENS, measure, GATE)
        assert sorted(np.flatnonzero(~used)) == sorted(wrong)
        good = stars.take(used)
        np.testing.assert_array_equal(
            belief.parameters, attitude_free.update(prior, good, LENS, measure).parameters)


@BOTH
def test_frame_of_other_stars_changes_nothing(measure):
    rng = np.random.default_rng(5)
    prior = CameraBelief(INTRINSICS, np.diag(INITIAL))
    strange = frame_of(12, rng)._replace(u_i=frame_of(12, rng).u_i)
    belief, used = attitude_free.screen(prior, strange, LENS, measure, GATE)
    assert not used.any() and belief is prior


@pytest.mark.parametrize('parameters', [INTRINSICS * np.nan,
                                        INTRINSICS + [0, 0, 0, 1e3, 1e4, 0, 0]])
def test_impossible_camera_is_no_crash(parameters):
    stars = frame_of(6, np.random.default_rng(6))
    prior = CameraBelief(parameters, np.diag(INITIAL))
    _, used = attitude_free.screen(prior, stars, LENS, angular_distance.full, GATE)
    assert not used.any()


# As a CameraMethod


def frames_of(count, rng, truth=INTRINSICS, first=0):
    """Return frames of 12 catalogue stars, 2 Hz, anywhere in the sky."""
    stars = catalog.load(6.5)
    stamps = 1_782_993_600_000_000_000 + (first + np.arange(count)) * 500_000_000
    uv_raster, hips = [], []
    for stamp in stamps:
        places = apparent_places(stars, np.arange(len(stars)), [stamp], [len(stars)],
                                 observer(Scenario().observer))
        r_s = places @ rotation.exp(rng.normal(size=3)).T
        uv = camera.project(r_s, truth, PITCH_MM)
        seen = np.flatnonzero((r_s[:, 2] > 0.9) & (np.abs(uv) < 500.0).all(axis=-1))[:12]
        uv_raster.append(uv[seen] + 511.5 + SIGMA * rng.standard_normal((len(seen), 2)))
        hips.append(stars.hip[seen])
    counts = [len(seen) for seen in hips]
    return Frames(stamps, np.concatenate(([0], np.cumsum(counts))), np.concatenate(uv_raster),
                  np.full(sum(counts), SIGMA), np.full(sum(counts), np.nan), np.concatenate(hips))


def begin(**options):
    return AttitudeFree(Scenario().replace(options), angular_distance.full, 2)


def test_estimate_begins_with_the_first_frame_and_stays_within_its_sigma():
    method = begin()
    assert method.estimate() is None
    method.add_frames(frames_of(60, np.random.default_rng(7)))
    estimate = method.estimate()
    assert (estimate.frames, estimate.stars) == (60, 60 * 12)
    assert (np.abs(estimate.intrinsics - INTRINSICS) < 4.0 * estimate.sigma).all()
    assert method.take_notices() == []


def test_what_is_not_estimated_stays_nominal_and_has_no_covariance():
    method = begin(**{'intrinsics.estimate': ('f', 'u0')})
    method.add_frames(frames_of(10, np.random.default_rng(8), truth=NOMINAL))
    estimate = method.estimate()
    fixed = np.array([name not in ('f', 'u0') for name in camera.INTRINSICS])
    np.testing.assert_array_equal(estimate.intrinsics[fixed], NOMINAL[fixed])
    assert not estimate.covariance[fixed].any() and not estimate.covariance[:, fixed].any()
    assert (estimate.sigma[~fixed] > 0.0).all()


def test_walk_of_an_intrinsic_keeps_its_sigma_up():
    frames = frames_of(40, np.random.default_rng(9))
    still, walking = begin(), begin(**{
        'estimator.process_noise.focal_length_mm_sqrt_h': 1.0})
    for method in (still, walking):
        method.add_frames(frames)
    # Between two frames f walks by 1 mm sqrt(0.5 / 3600), of which each frame takes its share.
    sigma, walked = (method.estimate().sigma[2] for method in (still, walking))
    assert 3.0 * sigma < walked < np.sqrt(0.5 / 3600.0)


def test_wrong_stars_are_counted():
    frames = frames_of(5, np.random.default_rng(11))
    frames.uv_raster[7] += 5.0
    method = begin()
    method.add_frames(frames)
    assert method.estimate().stars == 59
    assert method.take_notices() == ['1 stars that do not fit: rejected']


def test_calibration_begins_afresh_where_the_camera_has_changed():
    rng = np.random.default_rng(12)
    method = begin()
    method.add_frames(frames_of(60, rng))
    moved = INTRINSICS + [0, 0, 0.2, 0, 0, 0, 0]
    method.add_frames(frames_of(60, rng, truth=moved, first=60))
    assert any('begins afresh' in text for text in method.take_notices())
    estimate = method.estimate()
    assert (np.abs(estimate.intrinsics - moved) < 4.0 * estimate.sigma).all()


@pytest.fixture
def by_numpy(monkeypatch):
    """Return a function that does something without the compiled arithmetic."""
    def call(function, *args):
        with monkeypatch.context() as patch:
            for module in (invariants, attitude_free, singular_value):
                patch.setattr(module, 'kernel', None)
            return function(*args)
    return call


@pytest.mark.parametrize('stars', [3, 4, 31])
@pytest.mark.parametrize('wrong', [0, 1])
@pytest.mark.parametrize('measure', [angular_distance.full, SVD, partial(
    singular_value.measure, model=1, chosen=(1,), full=True), partial(
    singular_value.measure, model=2, chosen=(1, 3), full=False)])
def test_compiled_frame_is_that_of_numpy(by_numpy, measure, stars, wrong):
    """Same stars, estimates to 1e-6 sigma: the stars are turned upon 1e-9 rad alike."""
    rng = np.random.default_rng(20)
    frame = frame_of(stars, rng)
    frame.uv[:wrong] += 300.0
    prior = CameraBelief(INTRINSICS + 0.3 * INITIAL * rng.standard_normal(7), np.diag(INITIAL))
    given = prior, frame, LENS, measure, GATE
    (found, used), (expected, expected_used) = (
        attitude_free.screen(*given), by_numpy(attitude_free.screen, *given))
    np.testing.assert_array_equal(used, expected_used)
    np.testing.assert_allclose((found.parameters - expected.parameters) / expected.sigma, 0.0,
                               atol=1e-6)
    scale = np.outer(expected.sigma, expected.sigma)
    np.testing.assert_allclose(found.root @ found.root.T / scale,
                               expected.root @ expected.root.T / scale, atol=1e-6)


@pytest.mark.parametrize('away', [0.0, 1e-6, 1e-3, 0.1])
def test_compiled_alignment_takes_stars_that_are_close_together(by_numpy, away):
    """Two stars, also at one place, and three on a line."""
    uv = np.array([[100.0, 50.0], [100.0 + away / 2e-4, 50.0], [100.0 + away / 4e-4, 50.0]])
    u_i = camera.unproject(uv, INTRINSICS, PITCH_MM) @ rotation.exp(np.array([0.3, -0.2, 2.0]))
    for stars in (Stars(u_i[:2], uv[:2], np.full(2, SIGMA)), Stars(u_i, uv, np.full(3, SIGMA))):
        frame = invariants.linearize(stars, INTRINSICS, LENS)
        expected = by_numpy(invariants.linearize, stars, INTRINSICS, LENS)
        np.testing.assert_allclose(frame.r_s, expected.r_s, atol=1e-9)
        np.testing.assert_allclose(frame.z, expected.z, atol=1e-4)


def test_without_numba_numpy_does_it():
    program = ("import sys; sys.modules['numba'] = None\n"
               'from starcal_ros.calibration import attitude_free, frame_arithmetic\n'
               'assert frame_arithmetic.kernel is attitude_free.kernel is None')
    subprocess.run([sys.executable, '-c', program], check=True)
    assert attitude_free.kernel is not None
