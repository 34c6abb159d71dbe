# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Singular values: groups of stars, slopes, second order, both weightings."""

import numpy as np
import pytest

from instruments import INTRINSICS, LENS, PITCH_MM
from starcal_ros.calibration import invariants
from starcal_ros.calibration.methods import singular_value
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera, rotation
from starcal_ros.measurements.samples import Stars

SIGMA = 0.05
LENS_STEPS = np.diag([1.0, 1.0, 1e-2, 1e-6, 1e-8, 1e-6, 1e-6])


def frame_of(uv, rng, noise=1.0):
    """Return a frame of stars near some places of T18's detector."""
    u_i = camera.unproject(uv, INTRINSICS, PITCH_MM) @ rotation.exp(rng.normal(size=3))
    return Stars(u_i, uv + noise * SIGMA * rng.standard_normal(uv.shape),
                 np.full(len(uv), SIGMA))


@pytest.fixture
def stars():
    """Return a noisy frame of 9 stars."""
    rng = np.random.default_rng(1)
    return frame_of(rng.uniform(-500.0, 500.0, (9, 2)), rng)


def svd(w, model, chosen):
    """Return the singular values of all groups, the textbook way, (m k,)."""
    return np.array([np.linalg.svd(w[member > 0.0], compute_uv=False)[np.array(chosen) - 1]
                     for member in singular_value.groups(model, len(w))]).ravel()


def differences(function, steps):
    return np.stack([(function(step) - function(-step)) / (2.0 * step.sum())
                     for step in steps], axis=-1)


def literal(stars, model, chosen):
    """Return residuals, slopes by lens and by centroids: all by differences."""
    def values(uv, lens):
        return svd(camera.unproject(uv, lens, PITCH_MM), model, chosen)

    z = svd(stars.u_i, model, chosen) - values(stars.uv, INTRINSICS)
    A = -differences(lambda step: values(stars.uv, INTRINSICS + step), LENS_STEPS)
    J = differences(lambda step: values(stars.uv + step.reshape(-1, 2), INTRINSICS),
                    0.1 * np.eye(stars.uv.size))
    return z, A, J


@pytest.mark.parametrize('model, n, expected', [
    (1, 5, ['11100', '01110', '00111']),
    (2, 8, ['11110000', '01111000', '00111100', '00011110', '00001111']),
    (2, 4, ['1110', '0111']),
    (3, 4, ['0111', '1011', '1101', '1110']),
    (4, 5, ['11100', '11110', '11111']),
    (4, 3, ['111']),
    (4, 2, [])])
def test_groups_are_those_of_the_combination_models(model, n, expected):
    member = singular_value.groups(model, n)
    assert [''.join(f'{x:.0f}' for x in row) for row in member] == expected


@pytest.mark.parametrize('model', [1, 2, 3, 4])
def test_gram_matrices_hold_the_squared_singular_values(model, stars):
    squares = np.linalg.eigvalsh(
        singular_value.gram(singular_value.groups(model, 9), stars.u_i))[:, ::-1]
    np.testing.assert_allclose(np.sqrt(squares).ravel(), svd(stars.u_i, model, (1, 2, 3)),
                               rtol=1e-9)


@pytest.mark.parametrize('model', [1, 2, 3, 4])
@pytest.mark.parametrize('chosen', [(1,), (2,), (3,), (2, 3), (1, 2, 3)])
def test_slopes_by_centroids_agree_with_central_differences(model, chosen, stars):
    member = singular_value.groups(model, 9)
    w, dw_duv, _ = camera.backproject(stars.uv, INTRINSICS, PITCH_MM)
    squares, p = np.linalg.eigh(singular_value.gram(member, w))
    order = 3 - np.array(chosen)
    found = singular_value.slopes(member, w, p[..., order], np.sqrt(squares[..., order]), dw_duv)
    _, _, J = literal(stars, model, chosen)
    # 0.1 px against what parts the singular values, 20 px at least: squared.
    np.testing.assert_allclose(found.reshape(J.shape), J, atol=1e-4 * np.abs(J).max())


@pytest.mark.parametrize('chosen', [(2,), (2, 3)])
@pytest.mark.parametrize('full', [True, False])
def test_information_is_that_of_the_values_written_out(chosen, full, stars):
    z, A, J = literal(stars, 4, chosen)
    covariance = SIGMA**2 * J @ J.T
    if not full:
        covariance = np.diag(np.diag(covariance))
    found = singular_value.measure(invariants.linearize(stars, INTRINSICS, LENS), 4, chosen, full)
    weighted = np.linalg.solve(covariance, np.column_stack((z, A)))
    scale = np.sqrt(np.diag(found.matrix))
    # Slopes at the measured places there, at fitted ones here; and the second order, which is
    # not written out, is 1e-3 of the first in a frame like this.
    np.testing.assert_allclose(found.matrix / np.outer(scale, scale),
                               (A.T @ weighted[:, 1:]) / np.outer(scale, scale), atol=0.01)
    np.testing.assert_allclose(found.vector / scale, A.T @ weighted[:, 0] / scale, atol=0.03)


def test_all_but_one_with_their_covariance_know_what_all_angles_know(stars):
    """2 n singular values of rank 2 n - 3: nothing of Eq. (I.1) is lost but the second order."""
    frame = invariants.linearize(stars, INTRINSICS, LENS)
    everything = invariants.information(frame.z, frame.H).matrix
    found = singular_value.measure(frame, 3, (2, 3), True).matrix
    scale = np.sqrt(np.diag(everything))
    np.testing.assert_allclose(found / np.outer(scale, scale),
                               everything / np.outer(scale, scale), atol=0.01)


@pytest.mark.parametrize('model, chosen', [(4, (2, 3)), (1, (2, 3)), (4, (1, 2, 3))])
def test_no_choice_knows_more_than_all_angles(model, chosen, stars):
    frame = invariants.linearize(stars, INTRINSICS, LENS)
    everything = invariants.information(frame.z, frame.H).matrix
    scale = np.sqrt(np.diag(everything))
    lost = (everything - singular_value.measure(frame, model, chosen, True).matrix)
    assert np.linalg.eigvalsh(lost / np.outer(scale, scale)).min() > -1e-9


def test_second_order_is_that_of_many_draws():
    """What is left of sigma_2 and sigma_3 without their first order scatters as stated."""
    rng, draws, m, v = np.random.default_rng(2), 20_000, 8, 1e-4**2
    w = camera.unproject(rng.uniform(-500.0, 500.0, (m, 2)), INTRINSICS, PITCH_MM)
    squares, p = np.linalg.eigh(w.T @ w)
    sigma = np.sqrt(squares)
    noise = np.sqrt(v) * rng.standard_normal((draws, m, 3))
    noise -= np.sum(noise * w, axis=-1, keepdims=True) * w
    noisy = w + noise
    noisy /= np.linalg.norm(noisy, axis=-1, keepdims=True)
    first = np.einsum('jk,djk->dk', w @ p, noise @ p) / sigma
    left = np.linalg.svd(noisy, compute_uv=False)[:, ::-1] - sigma - first
    stated = singular_value.second_order(squares, np.array(float(m)), np.array(v))
    # m - 1 in place of m - 3. The variance of so many squares of normals is good to 2 %.
    expected = (stated - v**2 / squares)[:2]
    np.testing.assert_allclose(np.var(left, axis=0)[:2], expected, rtol=0.05)


@pytest.mark.parametrize('uv', [
    np.column_stack((np.linspace(-400.0, 400.0, 6), np.zeros(6))),      # on a great circle
    300.0 * np.column_stack((np.cos(np.arange(6) * np.pi / 3.0),        # sigma_2 = sigma_3
                             np.sin(np.arange(6) * np.pi / 3.0))),
    np.zeros((6, 2)),                                                   # all in one place
])
@pytest.mark.parametrize('model', [1, 2, 3, 4])
@pytest.mark.parametrize('full', [True, False])
@pytest.mark.parametrize('noise', [0.0, 1.0])
def test_degenerate_frames_tell_less_and_never_nonsense(uv, model, full, noise):
    pinhole = np.array([0.0, 0.0, 25.6, 0.0, 0.0, 0.0, 0.0])
    rng = np.random.default_rng(3)
    u_i = camera.unproject(uv, pinhole, PITCH_MM) @ rotation.exp(rng.normal(size=3))
    frame = invariants.linearize(
        Stars(u_i, uv + noise * SIGMA * rng.standard_normal(uv.shape), np.full(6, SIGMA)),
        pinhole, LENS)
    matrix, vector = singular_value.measure(frame, model, (1, 2, 3), full)
    assert np.isfinite(matrix).all() and np.isfinite(vector).all()
    if full:
        scale = np.array([1.0, 1.0, 1e-3, 1e-6, 1e-8, 1e-6, 1e-6])
        most = invariants.information(frame.z, frame.H).matrix
        lost = (most - matrix) * np.outer(scale, scale)
        assert np.linalg.eigvalsh(lost).min() > -1e-6 * np.abs(most * np.outer(scale, scale)).max()


def test_two_stars_tell_nothing():
    rng = np.random.default_rng(4)
    stars = frame_of(rng.uniform(-500.0, 500.0, (2, 2)), rng)
    frame = invariants.linearize(stars, INTRINSICS, LENS)
    matrix, vector = singular_value.measure(frame, 4, (2, 3), True)
    assert not matrix.any() and not vector.any()


def test_leading_axes_are_batches(stars):
    uv = stars.uv + SIGMA * np.random.default_rng(5).standard_normal((3, 9, 2))
    for full in (True, False):
        batch = singular_value.measure(
            invariants.linearize(stars._replace(uv=uv), INTRINSICS, LENS), 4, (2, 3), full)
        for run in range(3):
            frame = invariants.linearize(stars._replace(uv=uv[run]), INTRINSICS, LENS)
            alone = singular_value.measure(frame, 4, (2, 3), full)
            for part, expected in zip(batch, alone):
                np.testing.assert_allclose(part[run], expected, rtol=1e-6,
                                           atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize('chosen', [(), (2, 2)])
def test_choice_of_singular_values_is_checked(chosen):
    scenario = Scenario().replace({'intrinsics.singular_values': chosen})
    with pytest.raises(ConfigError, match='singular_values: got .* needs one at least'):
        singular_value.start(scenario)
