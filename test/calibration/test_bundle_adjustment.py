# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The bundle adjustment is least squares, says the truth about its error, and lets go of spots."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from instruments import INTRINSICS, PITCH_MM, TAN2018
from starcal_ros import calibration
from starcal_ros.calibration.bundle_adjustment import adjust
from starcal_ros.calibration.bundle_problem import BundleProblem, BundleState, Observations
from starcal_ros.calibration.bundle_start import attitudes
from starcal_ros.calibration.methods import bundle as bundle_method
from starcal_ros.core import camera, rotation
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.simulation import sensors

LENS = Tan2018Lens(PITCH_MM)
GATE, SIGMA = float(chi2.ppf(0.9999, 2)), 0.05
PRIOR = np.array([20.0, 20.0, 0.2, 1e-3, 1e-5, 1e-4, 1e-4])
PRIOR_P, WIDE = np.diag(PRIOR**2), np.diag((1e3 * PRIOR)**2)
START = INTRINSICS + np.array([-5.0, -10.0, -0.1, -2e-4, 1e-6, -2e-5, -2e-5])
NO_POINTS = np.empty((0, 3))


def scene(rng, frames, stars, sigma=SIGMA, spread_deg=4.0):
    """Return spots with places of frames that look about one way, and their attitudes."""
    u = rotation.exp(np.radians(spread_deg) * rng.uniform(-1.5, 1.5, (stars, 3))) @ [0.0, 0, 1]
    tilt = rng.uniform(-1.0, 1.0, (frames, 3)) * np.radians(spread_deg) * [0.6, 0.6, 20.0]
    C_si = rotation.exp(tilt)
    uv = camera.project(u @ np.swapaxes(C_si, -1, -2), INTRINSICS, PITCH_MM)
    seen = (np.abs(uv) < 512).all(axis=-1)
    frame, star = np.nonzero(seen)
    uv = uv[seen] + sigma * rng.standard_normal((seen.sum(), 2))
    return Observations(frame, uv, np.full(len(uv), max(sigma, 1e-3)), u[star],
                        np.full(len(uv), -1)), C_si, u, star


def without_places(spots, star):
    """Return the spots as if nobody knew the stars; the number of each is its point."""
    seen = np.bincount(star) >= 2
    keep = seen[star]
    number = np.cumsum(seen) - 1
    return spots._replace(
        frame=spots.frame[keep], uv=spots.uv[keep], sigma=spots.sigma[keep],
        u_i=np.zeros((keep.sum(), 3)), point=number[star[keep]]), seen


def jittered(C, rng, angle=1e-3):
    """Return attitudes some way off."""
    return rotation.exp(angle * rng.standard_normal((*C.shape[:-2], 3))) @ C


def test_without_noise_the_camera_is_found_exactly():
    rng = np.random.default_rng(1)
    spots, C_si, u, star = scene(rng, 12, 60, sigma=0.0)
    known = adjust(spots, START, jittered(C_si, rng), NO_POINTS, LENS, WIDE, GATE)
    np.testing.assert_allclose(known.intrinsics, INTRINSICS, rtol=1e-6, atol=1e-10)
    unidentified, seen = without_places(spots, star)
    free = adjust(unidentified, START, jittered(C_si, rng), u[seen], LENS, WIDE, GATE)
    np.testing.assert_allclose(free.intrinsics, INTRINSICS, rtol=1e-5, atol=1e-8)
    assert np.abs(known.residual).max() < 1e-6 and np.abs(free.residual).max() < 1e-6


@pytest.mark.parametrize('named', [True, False])
def test_it_is_the_least_squares_fit_of_all_unknowns(named):
    """scipy, with the slopes by differences and nothing eliminated, comes to the same."""
    rng = np.random.default_rng(2)
    spots, C_si, u, star = scene(rng, 4, 25)
    points = NO_POINTS
    if not named:
        spots, seen = without_places(spots, star)
        points = u[seen]
    scale = np.array([0.1, 0.1, 1e-4, 1e-6, 1e-8, 1e-6, 1e-6])
    basis = np.stack([np.linalg.svd(point[None])[2][1:].T for point in points]) if len(
        points) else np.empty((0, 3, 2))

    def misfit(x):
        intrinsics = INTRINSICS + scale * x[:7]
        C = rotation.exp(1e-5 * x[7:19].reshape(4, 3)) @ C_si
        moved = points + 1e-5 * (basis @ x[19:].reshape(-1, 2, 1))[..., 0]
        directions = spots.u_i if named else moved[spots.point]
        uv = camera.project((C[spots.frame] @ directions[..., None])[..., 0], intrinsics, PITCH_MM)
        held = [] if named else 1e3 * x[7:10]
        return np.concatenate((((spots.uv - uv) / SIGMA).ravel(),
                               scale * x[:7] / PRIOR, held))

    best = least_squares(misfit, np.zeros(19 + 2 * len(points)), '3-point', x_scale='jac',
                         xtol=1e-12)
    found = adjust(spots, INTRINSICS, C_si, points, LENS, PRIOR_P, np.inf)
    covariance = np.linalg.inv(best.jac.T @ best.jac)[:7, :7] * np.outer(scale, scale)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((found.intrinsics - INTRINSICS) / sigma, scale * best.x[:7] / sigma,
                               atol=5e-3)
    np.testing.assert_allclose(found.covariance / np.outer(sigma, sigma),
                               covariance / np.outer(sigma, sigma), atol=1e-3)


def test_focal_lengths_of_frames_are_the_least_squares_fit():
    """Each frame its own; scipy with nothing eliminated comes to the same, sigmas included."""
    rng, n = np.random.default_rng(4), 5
    own = np.array([0.0, 0.05, -0.03, 0.02, 0.06])
    spots, C_si, u, _ = scene(rng, n, 60)
    true = np.tile(INTRINSICS, (len(spots.frame), 1))
    shifted = true.copy()
    shifted[:, 2] += own[spots.frame]
    r_s = C_si[spots.frame] @ spots.u_i[..., None]
    shift = [camera.project(np.swapaxes(r_s, 1, 2), each, PITCH_MM)[:, 0]
             for each in (true, shifted)]
    spots = spots._replace(uv=spots.uv + shift[1] - shift[0])
    free = np.array([0, 1, 3, 4, 5, 6])
    scale = np.concatenate((np.full(3 * n, 1e-5), PRIOR[free] * 1e-3, np.full(n, 1e-3)))

    def misfit(x):
        x = scale * x
        C = rotation.exp(x[:3 * n].reshape(n, 3)) @ C_si
        intrinsics = np.tile(INTRINSICS, (len(spots.frame), 1))
        intrinsics[:, free] += x[3 * n:3 * n + 6]
        intrinsics[:, 2] += x[3 * n + 6:][spots.frame]
        uv = camera.project(np.swapaxes(C[spots.frame] @ spots.u_i[..., None], 1, 2), intrinsics,
                            PITCH_MM)[:, 0]
        return np.concatenate((((spots.uv - uv) / SIGMA).ravel(), x[3 * n:3 * n + 6] / PRIOR[free],
                               x[3 * n + 6:] / PRIOR[2]))

    best = least_squares(misfit, np.zeros(len(scale)), '3-point', x_scale='jac', xtol=1e-12)
    found = adjust(spots, INTRINSICS, C_si, NO_POINTS, LENS, PRIOR_P, np.inf, PRIOR[2])
    covariance = np.linalg.inv(best.jac.T @ best.jac) * np.outer(scale, scale)
    solution, f = scale * best.x, slice(3 * n + 6, None)
    sigma = np.sqrt(np.diag(covariance)[f])
    np.testing.assert_allclose(found.own_f[:, 1], sigma, rtol=1e-3)
    np.testing.assert_allclose((found.own_f[:, 0] - INTRINSICS[2] - solution[f]) / sigma, 0.0,
                               atol=5e-3)
    assert found.intrinsics[2] == pytest.approx(found.own_f[:, 0].mean())
    # The camera with the mean of the focal lengths.
    T = np.zeros((7, len(scale)))
    T[free, 3 * n + np.arange(6)], T[2, f] = 1.0, 1.0 / n
    expected = T @ covariance @ T.T
    root = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.covariance / np.outer(root, root),
                               expected / np.outer(root, root), atol=2e-3)
    assert found.freedom == 2 * len(spots.frame) - 4 * n - 6


@pytest.mark.slow
@pytest.mark.parametrize('named', [True, False])
def test_covariance_says_the_truth(named):
    """NEES of independent runs lies in its 99.9 % interval."""
    runs, total = 60, 0.0
    for seed in range(runs):
        rng = np.random.default_rng([3, seed])
        spots, C_si, u, star = scene(rng, 10, 40)
        start, points = INTRINSICS + PRIOR * rng.standard_normal(7), NO_POINTS
        if not named:
            spots, seen = without_places(spots, star)
            points = u[seen]
        found = adjust(spots, start, jittered(C_si, rng), points, LENS, PRIOR_P, GATE)
        error = found.intrinsics - INTRINSICS
        total += error @ np.linalg.solve(found.covariance, error)
    low, high = chi2.ppf([0.0005, 0.9995], 7 * runs) / runs
    assert low < total / runs < high


def test_what_is_held_stays():
    rng = np.random.default_rng(4)
    spots, C_si, *_ = scene(rng, 8, 40)
    prior = PRIOR * [1, 1, 1, 1, 0, 0, 0]
    found = adjust(spots, START, C_si, NO_POINTS, LENS, np.diag(prior**2), GATE)
    assert (found.intrinsics[4:] == START[4:]).all() and not found.covariance[4:].any()
    assert (np.diag(found.covariance)[:4] > 0.0).all()


@pytest.mark.parametrize('part', [0.1, 0.3])
@pytest.mark.parametrize('where', ['field', 'sky'])
def test_wrong_stars_are_let_go(part, where):
    """Some stars bear the place of another; the rest give the camera as without them."""
    rng = np.random.default_rng(5)
    spots, C_si, *_ = scene(rng, 20, 60)
    wrong = rng.random(len(spots.frame)) < part
    places = spots.u_i.copy()
    anywhere = rng.normal(size=places.shape)
    anywhere /= np.linalg.norm(anywhere, axis=-1, keepdims=True)
    places[wrong] = (np.roll(places, 7, axis=0) if where == 'field' else anywhere)[wrong]
    spots = spots._replace(u_i=places)
    start = attitudes(spots, camera.unproject(spots.uv, START, PITCH_MM))
    assert np.degrees(np.linalg.norm(rotation.log(start @ np.swapaxes(C_si, -1, -2)),
                                     axis=-1)).max() < 1.4         # a tenth of the field
    found = adjust(spots, START, start, NO_POINTS, LENS, PRIOR_P, GATE)
    alone = adjust(Observations(*(column[~wrong] for column in spots)), START, start,
                   NO_POINTS, LENS, PRIOR_P, GATE)
    assert not found.used[wrong].any() and found.used[~wrong].mean() > 0.998
    sigma = np.sqrt(np.diag(alone.covariance))
    np.testing.assert_allclose((found.intrinsics - alone.intrinsics) / sigma, 0.0, atol=2e-3)


@pytest.mark.parametrize('shift', [(2.0, 0.0), (0.0, 2.0)], ids=['u', 'v'])
@pytest.mark.parametrize('seed', range(3))
def test_spots_that_are_off_together_do_not_pull_the_camera_to_them(seed, shift):
    """A fifth of them, at one edge, by 40 sigma: a plain fit takes most of it for distortion."""
    spots, C_si, *_ = scene(np.random.default_rng([10, seed]), 12, 60)
    u = spots.uv[:, 0]
    wrong = u > np.quantile(u, 0.8)
    spots = spots._replace(uv=spots.uv + np.outer(wrong, shift))
    found = adjust(spots, START, C_si, NO_POINTS, LENS, PRIOR_P, GATE)
    alone = adjust(Observations(*(column[~wrong] for column in spots)), START, C_si, NO_POINTS,
                   LENS, PRIOR_P, GATE)
    assert not found.used[wrong].any()
    np.testing.assert_array_equal(found.used[~wrong], alone.used)
    # In the end both fit the same spots, from where they stand: to a step of 1e-3 sigma.
    sigma = np.sqrt(np.diag(alone.covariance))
    np.testing.assert_allclose((found.intrinsics - alone.intrinsics) / sigma, 0.0, atol=2e-3)


def test_groups_that_share_no_star_each_keep_one_attitude():
    rng = np.random.default_rng(6)
    spots, C_si, u, star = scene(rng, 6, 40, sigma=0.0)
    unidentified, seen = without_places(spots, star)
    count = int(seen.sum())
    twice = Observations(*(np.concatenate(pair) for pair in (
        (unidentified.frame, unidentified.frame + 6), (unidentified.uv, unidentified.uv),
        (unidentified.sigma, unidentified.sigma), (unidentified.u_i, unidentified.u_i),
        (unidentified.point, unidentified.point + count))))
    turn = rotation.exp(np.array([0.3, -0.2, 1.0]))
    found = adjust(twice, START, np.concatenate((C_si, C_si @ turn.T)),
                   np.concatenate((u[seen], u[seen] @ turn.T)), LENS, WIDE, GATE)
    np.testing.assert_allclose(found.intrinsics, INTRINSICS, rtol=1e-5, atol=1e-8)


def test_attitudes_solve_wahbas_problem():
    rng = np.random.default_rng(7)
    spots, C_si, *_ = scene(rng, 5, 30, sigma=0.0)
    found = attitudes(spots, camera.unproject(spots.uv, INTRINSICS, PITCH_MM))
    np.testing.assert_allclose(found, C_si, atol=1e-9)
    mirrored = rotation.wahba(np.diag([1.0, 1.0, -1.0]))
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


@pytest.fixture(scope='module')
def unidentified():
    """Return the gyro readings and the unidentified frames of two slews, and the scenario."""
    scenario = TAN2018.replace({
        'simulation.duration_s': 200.0, 'intrinsics.method': 'bundle',
        'camera.focal_length_mm': 23.0, 'estimator.initial_sigma.focal_length_mm': 2.5})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    frames = tracker.next(tracker.count)
    return gyro.next(gyro.count), replace(frames, catalog_id=0 * frames.catalog_id), scenario


def test_spots_without_a_name_give_camera_and_distortion(unidentified):
    """From a focal length that is a tenth wrong, with the gyro and without."""
    gyro, frames, scenario = unidentified
    found = []
    for readings in (gyro, GyroSamples.empty()):
        method = calibration.start(scenario)
        method.add_gyro(readings)
        method.add_frames(frames)
        found.append(method.estimate())
    error = found[0].intrinsics - INTRINSICS
    assert error @ np.linalg.solve(found[0].covariance, error) < 24.3   # 0.999 of chi-square, 7
    assert found[0].sigma[2] < 0.03 and found[0].sigma[3] < 0.02 * INTRINSICS[3]
    np.testing.assert_allclose((found[1].intrinsics - found[0].intrinsics) / found[0].sigma, 0.0,
                               atol=0.05)
    assert 0.95 * bundle_method.FRAMES < found[0].frames <= bundle_method.FRAMES


def test_frames_that_show_nothing_give_no_camera(unidentified):
    gyro, frames, scenario = unidentified
    method = calibration.start(scenario)
    assert method.estimate() is None
    method.add_frames(frames[:2])
    assert method.estimate() is None


def test_spots_that_no_camera_fits_give_none_and_it_is_said(unidentified):
    """Random spots: the tracks are chance, and next to nothing of them agrees with any camera."""
    _, frames, scenario = unidentified
    rng = np.random.default_rng(8)
    uv = rng.uniform(0.0, 1023.0, frames.uv_raster.shape)
    method = calibration.start(scenario)
    method.add_frames(replace(frames, uv_raster=uv)[:40])
    assert method.estimate() is None


def test_a_point_of_which_no_spot_is_left_stays_and_tells_nothing():
    rng = np.random.default_rng(9)
    spots, C_si, u, star = scene(rng, 12, 60)
    unidentified, seen = without_places(spots, star)
    problem = BundleProblem(unidentified, START, LENS, WIDE)
    state = BundleState(START, C_si, u[seen])
    lost = unidentified.point == 5
    normal = problem.normal(problem.look(state), np.where(lost, 0.0, 1.0 / SIGMA))
    step = normal.solve()
    assert not step.point[5].any() and np.isfinite(step.camera).all()
    without = unidentified._replace(point=np.where(unidentified.point > 5, unidentified.point - 1,
                                                   unidentified.point))
    without = Observations(*(part[~lost] for part in without))
    problem = BundleProblem(without, START, LENS, WIDE)
    other = problem.normal(
        problem.look(state._replace(points=np.delete(state.points, 5, axis=0))),
        np.full((~lost).sum(), 1.0 / SIGMA))
    np.testing.assert_allclose(normal.camera_covariance(), other.camera_covariance(), rtol=1e-6)
