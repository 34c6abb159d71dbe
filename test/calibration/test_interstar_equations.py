# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reduced equations are the literal ones, and their derivatives and noise are right."""

from functools import partial
from itertools import combinations
import subprocess
import sys

import numpy as np
import pytest

from starcal_ros.calibration import interstar_complete
from starcal_ros.calibration import interstar_equations as interstar
from starcal_ros.calibration.interstar_arithmetic import pinhole_equations
from starcal_ros.calibration.interstar_complete import normal_equations
from starcal_ros.core import camera
from starcal_ros.evaluation import consistency
from starcal_ros.reproduction.self2024 import (LARGEST, PITCH_MM, START, TRUTH, Point, evaluate,
                                               scenes, spots)

POINT = Point(frames=9, stars=6)
DISTORTED = np.array([3.0, -2.0, 24.5, 2e-4, -1e-6, 1e-5, -2e-5])
NOISE_PX = 0.1


def draw(seed, count=1, point=POINT):
    """Return catalogue directions (count, NS, 3) and noisy spots (count, NF, NS, 2) [px]."""
    rng = np.random.default_rng(seed)
    v, C_si = scenes(rng, count, point)
    uv = spots(v, C_si)
    return v, uv + NOISE_PX * rng.standard_normal(uv.shape)


def some_missing(seed=4):
    """Return a mask (NF, NS) in which a star is seen once, one never, and pairs now and then."""
    seen = np.random.default_rng(seed).random((POINT.frames, POINT.stars)) < 0.6
    seen[:, 0], seen[2, 0] = False, True
    seen[:, 1] = False
    return seen


def literal(sight, cosines, seen):
    """Form A and e as they are written, S24 Eq. 4, 8, 11, 12; return A'A and A'e."""
    w, b = np.moveaxis(sight.w, 0, -1), np.moveaxis(sight.instruments, (0, 1), (-2, -1))
    A, e = [], []

    def row(m, i, j):
        return b[m, i] @ w[m, j] + b[m, j] @ w[m, i]

    for i, j in combinations(range(seen.shape[1]), 2):
        frames = [m for m in range(seen.shape[0]) if seen[m, i] and seen[m, j]]
        if cosines is not None:
            A += [row(m, i, j) for m in frames]
            e += [w[m, i] @ w[m, j] - cosines[i, j] for m in frames]
            continue
        for m, n in combinations(frames, 2):
            A.append(row(m, i, j) - row(n, i, j))
            e.append(w[m, i] @ w[m, j] - w[n, i] @ w[n, j])
    A, e = np.array(A), np.array(e)
    return A.T @ A, A.T @ e


@pytest.mark.parametrize('missing', [False, True])
@pytest.mark.parametrize('identified', [False, True])
@pytest.mark.parametrize('constrained', [False, True])
@pytest.mark.parametrize('model', ['pinhole', 'lens'])
def test_sums_over_pairs_are_the_literal_ones(model, constrained, identified, missing):
    v, uv = draw(1)
    seen = some_missing() if missing else np.ones((POINT.frames, POINT.stars), bool)
    if model == 'pinhole' and not missing:
        sight = interstar.pinhole(uv[0], TRUTH + (5.0, 3.0, 0.2), PITCH_MM, constrained)
    else:
        sight = interstar.lens(uv[0] - 768.0, DISTORTED, PITCH_MM, (0, 1, 2, 3), constrained, seen)
    cosines = v[0] @ v[0].T if identified else None
    equations = interstar.equations(sight, cosines, seen if missing else None)
    normal, value = literal(sight, cosines, seen)
    # Rounding: of terms of the size of b w w, over the smallest sums.
    np.testing.assert_allclose(equations.product(sight.instruments), normal, rtol=1e-7)
    np.testing.assert_allclose(equations.value, value, rtol=1e-6)
    if not missing:
        value_complete, normal_complete = normal_equations(sight, sight.instruments, cosines)
        np.testing.assert_allclose(normal_complete, normal, rtol=1e-7)
        np.testing.assert_allclose(value_complete, value, rtol=1e-6)
        _, matrix = normal_equations(sight, sight.by_intrinsics, cosines)
        np.testing.assert_allclose(matrix, equations.product(sight.by_intrinsics), rtol=1e-7)


def test_rounds_are_batches():
    v, uv = draw(2, count=3)
    cosines = v @ np.swapaxes(v, -1, -2)
    x = TRUTH + np.array([[1.0, 2.0, 0.1], [0.0, 0.0, 0.0], [-5.0, 4.0, -0.3]])
    for given in (None, cosines):
        value, matrix = evaluate(x, uv, given, True)
        for k in range(3):
            one = evaluate(x[k:k + 1], uv[k:k + 1], None if given is None else given[k:k + 1],
                           True)
            np.testing.assert_allclose(value[k], one[0][0], rtol=1e-9)
            np.testing.assert_allclose(matrix[k], one[1][0], rtol=1e-9)


def test_pinhole_is_a_lens_without_distortion():
    _, uv = draw(3)
    x, seen = np.array([2.0, -3.0, 24.0]), np.ones((POINT.frames, POINT.stars), bool)
    for constrained in (False, True):
        pinhole = interstar.pinhole(uv[0] - 768.0, x, PITCH_MM, constrained)
        lens = interstar.lens(uv[0] - 768.0, np.append(x, np.zeros(4)), PITCH_MM, (0, 1, 2),
                              constrained, seen)
        for a, b in zip(pinhole, lens):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-16)


def test_instruments_hold_the_optical_path():
    """WC, S24 Eq. 13: b is dq/dX / r, with q = (-x, -y, f), (x, y) the undistorted spot [mm]."""
    _, uv = draw(5)
    uv, seen = uv[0] - 768.0, np.ones((POINT.frames, POINT.stars), bool)
    sight = interstar.lens(uv, DISTORTED, PITCH_MM, range(7), True, seen)

    def q(intrinsics):
        w = camera.unproject(uv, intrinsics, PITCH_MM)
        return np.moveaxis(w * intrinsics[2] / w[..., 2:], -1, 0)

    r = np.linalg.norm(q(DISTORTED), axis=0)
    step = np.array([0.1, 0.1, 1e-3, 1e-6, 1e-8, 1e-6, 1e-6])
    for k, axis in enumerate(np.eye(7) * step):
        numeric = (q(DISTORTED + axis) - q(DISTORTED - axis)) / (2.0 * step[k]) / r
        np.testing.assert_allclose(sight.instruments[k], numeric,
                                   atol=1e-6 * np.abs(numeric).max())


def test_directions_have_the_derivatives_of_central_differences():
    _, uv = draw(6)
    x = TRUTH + (20.0, -10.0, 0.5)
    sight = interstar.pinhole(uv[0], x, PITCH_MM, False)
    for k, step in enumerate((1.0, 1.0, 1e-2)):
        h = step * np.eye(3)[k]
        numeric = (interstar.pinhole(uv[0], x + h, PITCH_MM, False).w
                   - interstar.pinhole(uv[0], x - h, PITCH_MM, False).w) / (2.0 * step)
        # The third derivative is the first over r^2 or so, and step << r.
        np.testing.assert_allclose(sight.by_intrinsics[k], numeric, atol=1e-6 / 24.0)
    for k in range(2):
        h = np.eye(2)[k]
        numeric = (interstar.pinhole(uv[0] + h, x, PITCH_MM, False).w
                   - interstar.pinhole(uv[0] - h, x, PITCH_MM, False).w) / 2.0
        np.testing.assert_allclose(sight.by_spot[k], numeric, atol=1e-6 / 24.0)


@pytest.mark.parametrize('identified', [False, True])
@pytest.mark.parametrize('constrained', [False, True])
def test_value_has_the_derivatives_of_central_differences(constrained, identified):
    """By the intrinsics and by a spot, at the truth without noise, where they are exact."""
    v, C_si = scenes(np.random.default_rng(7), 1, POINT)
    uv = spots(v, C_si)
    cosines = v @ np.swapaxes(v, -1, -2) if identified else None
    sight = interstar.pinhole(uv, TRUTH[None], PITCH_MM, constrained)
    equations = interstar.equations(sight, cosines)
    matrix = equations.product(sight.by_intrinsics)[0]
    step = np.array([0.1, 0.1, 1e-3])
    numeric = np.stack([(evaluate(TRUTH[None] + h, uv, cosines, constrained)[0][0]
                         - evaluate(TRUTH[None] - h, uv, cosines, constrained)[0][0])
                        / (2.0 * h.sum()) for h in np.diag(step)], axis=-1)
    scale = np.sqrt(np.outer(*(np.abs(np.diag(matrix)),) * 2))
    np.testing.assert_allclose(matrix / scale, numeric / scale, atol=2e-4)
    square = np.zeros((3, 3))
    for place in np.ndindex(uv.shape):
        h = np.zeros_like(uv)
        h[place] = 0.1
        slope = (evaluate(TRUTH[None], uv + h, cosines, constrained)[0][0]
                 - evaluate(TRUTH[None], uv - h, cosines, constrained)[0][0]) / 0.2
        square += np.outer(slope, slope)
    noise = equations.noise(sight.by_spot, 1.0)[0]
    scale = np.sqrt(np.outer(*(np.diag(square),) * 2))
    np.testing.assert_allclose(noise / scale, square / scale, atol=1e-3)


@pytest.mark.parametrize('identified', [False, True])
@pytest.mark.parametrize('constrained', [False, True])
def test_camera_is_found_from_the_papers_first_guess(constrained, identified):
    """Without noise exactly, and lambda changes the way there, not the place."""
    v, C_si = scenes(np.random.default_rng(8), 4, Point(frames=20, stars=12))
    problem = partial(evaluate, uv=spots(v, C_si), constrained=constrained,
                      cosines=v @ np.swapaxes(v, -1, -2) if identified else None)
    start = np.broadcast_to(START, (4, 3))
    for scale, steps in ((None, 20), (100.0 if constrained else 1.0, 300)):
        x = interstar.solve(partial(problem, scale=scale), start, LARGEST, steps)
        np.testing.assert_allclose(x, np.broadcast_to(TRUTH, (4, 3)), atol=1e-5)


def test_wrong_spot_is_told_by_its_misfit():
    v, C_si = scenes(np.random.default_rng(9), 1, Point(frames=12, stars=10))
    uv = spots(v, C_si)
    uv[0, 3, 4] += (3.0, -2.0)
    seen = np.ones(uv.shape[:-1], bool)
    seen[0, 5, :6] = False
    sight = interstar.lens(uv[0] - 768.0, np.append(TRUTH - (768.0, 768.0, 0.0), np.zeros(4)),
                           PITCH_MM, (0, 1, 2), True, seen[0])
    for cosines, own in ((v[0] @ v[0].T, 1.0), (None, 1.0 - 1.0 / 12.0)):
        misfit = interstar.misfit(sight, cosines, seen[0])
        # Compared with one another, the frames share the blame: 1/12 of it is the mean's.
        np.testing.assert_allclose(misfit[3, 4], own * np.array([3.0, -2.0]), rtol=0.05)
        others = np.linalg.norm(misfit, axis=-1)
        others[3, 4] = 0.0
        assert others.max() < 0.5 * np.hypot(3.0, 2.0)


@pytest.mark.parametrize('method', ['TCOC', 'TCWC', 'SCWC'])
def test_covariance_is_that_of_the_errors(method):
    """NEES of 200 rounds. Not SCOC: its bias is several of its sigmas."""
    constrained, point, n = method.endswith('WC'), Point(frames=40, stars=15), 200
    v, uv = draw(10, n, point)
    cosines = v @ np.swapaxes(v, -1, -2) if method.startswith('T') else None
    problem = partial(evaluate, uv=uv, cosines=cosines, constrained=constrained)
    x = interstar.solve(problem, np.broadcast_to(START, (n, 3)), LARGEST, 20)
    sight = interstar.pinhole(uv, x, PITCH_MM, constrained)
    equations = interstar.equations(sight, cosines)
    covariance = interstar.covariance(equations.product(sight.by_intrinsics),
                                      equations.noise(sight.by_spot, NOISE_PX))
    error = (x - TRUTH)[..., None]
    nees = (np.swapaxes(error, -1, -2) @ np.linalg.solve(covariance, error))[:, 0, 0]
    assert float(nees.mean()) in consistency.mean_interval(3, n, 0.999)


def test_expectation_of_the_equations_is_known():
    """The mean over noises n and -n, which cancels what is odd; S without constraint."""
    n, point = 150, Point(frames=20, stars=10)
    v, C_si = scenes(np.random.default_rng(11), n, point)
    uv = spots(v, C_si)
    noise = NOISE_PX * np.random.default_rng(12).standard_normal(uv.shape)
    look = partial(interstar.pinhole, intrinsics=np.broadcast_to(TRUTH, (n, 3)),
                   pitch_mm=PITCH_MM, constrained=False)
    value = 0.5 * (interstar.equations(look(uv + noise)).value
                   + interstar.equations(look(uv - noise)).value)
    known = interstar.bias(look, uv + noise, NOISE_PX)
    chance = np.std(value - known.value, axis=0) / np.sqrt(n)
    assert (np.abs(np.mean(value - known.value, axis=0)) < 4.0 * chance).all()
    assert np.abs(known.value.mean(axis=0))[2] > 50.0 * chance[2]       # f: there is a bias
    ratio = known.squares / known.expected
    sigma = np.sqrt(known.variance) / known.expected
    assert abs(ratio.mean() - 1.0) < 4.0 * sigma.mean() / np.sqrt(n)
    # The variance leaves out a part of 1/NS or so.
    low, high = consistency.rms_interval(n, 0.999)
    assert low < np.sqrt(np.mean(((ratio - 1.0) / sigma)**2)) < high * (1.0 + 1.0 / point.stars)


def test_expectation_is_the_same_with_a_lens_and_spots_missing():
    """Spots never seen together with others add nothing; all seen is the case without a mask."""
    v, uv = draw(13)
    seen = np.ones((POINT.frames, POINT.stars), bool)
    look = partial(interstar.lens, intrinsics=DISTORTED, pitch_mm=PITCH_MM,
                   estimated=(0, 1, 2, 3), constrained=False)
    plain = interstar.bias(partial(look, seen=seen), uv[0] - 768.0, NOISE_PX)
    masked = interstar.bias(partial(look, seen=seen), uv[0] - 768.0, NOISE_PX, seen)
    wider = np.concatenate((uv[0], np.full((POINT.frames, 1, 2), 700.0)), axis=1) - 768.0
    once = np.zeros((POINT.frames, 1), bool)
    once[3] = True
    more = np.concatenate((seen, once), axis=1)
    added = interstar.bias(partial(look, seen=more), wider, NOISE_PX, more)
    for a, b, c in zip(plain, masked, added):
        # Rounding of numeric derivatives, and of squares: of n q q, which all but cancel.
        np.testing.assert_allclose(a, b, rtol=1e-5)
        np.testing.assert_allclose(a, c, rtol=1e-5)


@pytest.mark.parametrize('newton', [False, True])
@pytest.mark.parametrize('constrained', [False, True])
@pytest.mark.parametrize('identified', [False, True])
def test_compiled_equations_are_the_reduced_ones(identified, constrained, newton):
    v, uv = draw(7, 3)
    x = TRUTH + np.array([[0.0, 0.0, 0.0], [20.0, -30.0, 1.0], [-200.0, 100.0, -2.0]])
    given = (uv, x, PITCH_MM, v @ np.swapaxes(v, -1, -2) if identified else None, constrained,
             newton)
    value, matrix = pinhole_equations(*given)
    expected, expected_matrix = interstar_complete.pinhole_equations(*given)
    # The root moves by less than a tenth of what ends an iteration.
    size = np.abs(expected_matrix) @ LARGEST
    assert (np.abs(value - expected) < 0.1 * interstar.CONVERGED * size).all()
    scale = np.sqrt(np.einsum('rkk->rk', expected_matrix))
    np.testing.assert_allclose(matrix / scale[:, :, None] / scale[:, None],
                               expected_matrix / scale[:, :, None] / scale[:, None], atol=1e-9)


def test_without_numba_the_reduced_equations_run():
    program = ("import sys; sys.modules['numba'] = None\n"
               'from starcal_ros.calibration import interstar_arithmetic, interstar_complete\n'
               'assert interstar_arithmetic.pinhole_equations is '
               'interstar_complete.pinhole_equations')
    subprocess.run([sys.executable, '-c', program], check=True)
    assert pinhole_equations is not interstar_complete.pinhole_equations


@pytest.mark.parametrize('rounds', [1, 3])
def test_lens_takes_one_camera_or_one_a_round(rounds):
    _, uv = draw(14, rounds)
    uv, seen = uv - 768.0, np.stack([some_missing(k) for k in range(rounds)])
    cameras = DISTORTED + 0.01 * np.arange(rounds)[:, None] * np.eye(7)[2]
    sight = interstar.lens(uv, cameras, PITCH_MM, (0, 2, 3), True, seen)
    for k in range(rounds):
        one = interstar.lens(uv[k], cameras[k], PITCH_MM, (0, 2, 3), True, seen[k])
        for a, b in zip(sight, one):
            np.testing.assert_allclose(a[..., k, :, :], b, rtol=1e-13, atol=1e-18)
