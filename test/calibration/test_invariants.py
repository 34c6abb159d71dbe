# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A frame without an attitude: alignment, slopes, and what a rotation does not change."""

import numpy as np
import pytest

from instruments import INTRINSICS, LENS, PITCH_MM
from starcal_ros.calibration import invariants
from starcal_ros.core import camera, rotation
from starcal_ros.measurements.samples import Stars

SIGMA = 0.05
STEP = np.array([1.0, 1.0, 1e-2, 1e-6, 1e-8, 1e-6, 1e-6])


def frame_of(n, rng, noise=0.0):
    """Return a frame of n stars that T18's camera sees at some attitude, and that attitude."""
    C_si = rotation.exp(rng.normal(size=3))
    uv = rng.uniform(-500.0, 500.0, (n, 2))
    u_i = camera.unproject(uv, INTRINSICS, PITCH_MM) @ C_si
    sigma = SIGMA * rng.uniform(1.0, 2.0, n)
    return Stars(u_i, uv + noise * sigma[:, None] * rng.standard_normal((n, 2)), sigma), C_si


@pytest.mark.parametrize('n', [2, 3, 20])
def test_alignment_is_the_attitude_and_a_proper_rotation(n):
    rng = np.random.default_rng(n)
    stars, C_si = frame_of(n, rng)
    found = invariants.align(stars.u_i, camera.unproject(stars.uv, INTRINSICS, PITCH_MM),
                             1.0 / stars.sigma[:, None])
    np.testing.assert_allclose(found, C_si, atol=1e-12)
    assert np.linalg.det(found) == pytest.approx(1.0)


def test_alignment_of_mirrored_stars_is_no_reflection():
    stars, _ = frame_of(10, np.random.default_rng(2))
    found = invariants.align(stars.u_i, stars.u_i * [1.0, 1.0, -1.0], np.ones((10, 1)))
    assert np.linalg.det(found) == pytest.approx(1.0)


def test_nothing_is_left_of_a_frame_without_noise_at_the_true_camera():
    stars, C_si = frame_of(12, np.random.default_rng(3))
    frame = invariants.linearize(stars, INTRINSICS, LENS)
    np.testing.assert_allclose(frame.r_s, stars.u_i @ C_si.T, atol=1e-13)
    np.testing.assert_allclose(frame.z, 0.0, atol=1e-7)         # rounding of 1e-9 px


def test_no_rotation_is_left_in_residuals_and_slopes():
    """P N = 0, so a frame tells 2 n - 3 numbers; and it tells the same at any attitude."""
    rng = np.random.default_rng(4)
    stars, _ = frame_of(12, rng, noise=1.0)
    frame = invariants.linearize(stars, INTRINSICS, LENS)
    N = frame.N.reshape(-1, 3)
    P = np.eye(24) - frame.Q @ frame.Q.T
    np.testing.assert_allclose(P @ N, 0.0, atol=1e-11 * np.abs(N).max())
    assert np.linalg.matrix_rank(P) == 2 * 12 - 3
    np.testing.assert_allclose(frame.Q.T @ frame.z, 0.0, atol=1e-12)
    turned = invariants.linearize(stars._replace(u_i=stars.u_i @ rotation.exp(
        rng.normal(size=3))), INTRINSICS, LENS)
    np.testing.assert_allclose(turned.z, frame.z, atol=1e-8)
    np.testing.assert_allclose(turned.H, frame.H, rtol=1e-8, atol=1e-8 * np.abs(frame.H).max())


def test_slopes_are_those_of_the_residuals():
    """At the truth of a frame without noise z vanishes, and its differences are P H alone."""
    stars, _ = frame_of(12, np.random.default_rng(5))
    H = invariants.linearize(stars, INTRINSICS, LENS).H
    numeric = np.stack([
        (invariants.linearize(stars, INTRINSICS + step, LENS).z
         - invariants.linearize(stars, INTRINSICS - step, LENS).z) / (2.0 * step.sum())
        for step in np.diag(STEP)], axis=-1)
    # The cubic term: a step of 1 px turns the frame by 2.5e-4 rad, whose square is 6e-8.
    scale = np.abs(H).max(axis=0)
    np.testing.assert_allclose(H / scale, numeric / scale, atol=1e-6)


def test_directions_move_with_the_centroids_as_the_camera_says():
    stars, _ = frame_of(12, np.random.default_rng(6))
    frame = invariants.linearize(stars, INTRINSICS, LENS)
    _, dw_duv, _ = camera.backproject(stars.uv, INTRINSICS, PITCH_MM)
    np.testing.assert_allclose(invariants.direction_slopes(frame),
                               dw_duv * stars.sigma[:, None, None], atol=1e-15)


def test_information_is_that_of_least_squares():
    rng = np.random.default_rng(7)
    H, z = rng.normal(size=(9, 4)), rng.normal(size=9)
    matrix, vector = invariants.information(z, H)
    np.testing.assert_allclose(np.linalg.solve(matrix, vector),
                               np.linalg.lstsq(H, z, rcond=None)[0])


def test_information_of_a_frame_is_that_of_an_adjustment_with_its_attitude_eliminated():
    """The attitude as three more unknowns, then the Schur complement: P is nothing else."""
    stars, _ = frame_of(12, np.random.default_rng(8), noise=1.0)
    frame = invariants.linearize(stars, INTRINSICS, LENS)
    _, N, H = LENS.linearize(frame.r_s, INTRINSICS)
    A = (np.concatenate((N, H), axis=-1) / stars.sigma[:, None, None]).reshape(-1, 10)
    whole = A.T @ A
    schur = whole[3:, 3:] - whole[3:, :3] @ np.linalg.solve(whole[:3, :3], whole[:3, 3:])
    scale = np.sqrt(np.diag(schur))
    np.testing.assert_allclose(frame.H.T @ frame.H / np.outer(scale, scale),
                               schur / np.outer(scale, scale), atol=1e-9)


def test_leading_axes_are_batches():
    rng = np.random.default_rng(9)
    stars, _ = frame_of(12, rng)
    uv = stars.uv + SIGMA * rng.standard_normal((3, 12, 2))
    lenses = INTRINSICS + 0.1 * STEP * rng.standard_normal((3, 7))
    batch = invariants.linearize(Stars(stars.u_i, uv, stars.sigma), lenses, LENS)
    for run in range(3):
        alone = invariants.linearize(stars._replace(uv=uv[run]), lenses[run], LENS)
        for part, expected in zip((*batch[:-1], batch.Q @ np.swapaxes(batch.Q, -1, -2)),
                                  (*alone[:-1], alone.Q @ alone.Q.T)):
            np.testing.assert_allclose(part[run], expected, rtol=1e-6, atol=1e-7)


def test_camera_that_can_not_have_seen_the_stars_is_refused():
    stars, _ = frame_of(4, np.random.default_rng(10))
    with np.errstate(all='ignore'), pytest.raises(np.linalg.LinAlgError):
        invariants.linearize(stars, INTRINSICS * np.nan, LENS)
