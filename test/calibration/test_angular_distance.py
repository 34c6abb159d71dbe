# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Angular distances: cosines, their slopes and variances, and both weightings."""

import numpy as np
import pytest

from instruments import INTRINSICS, LENS, PITCH_MM
from starcal_ros.calibration import invariants
from starcal_ros.calibration.methods import angular_distance
from starcal_ros.core import camera, rotation
from starcal_ros.measurements.samples import Stars

SIGMA = 0.05


@pytest.fixture
def stars():
    """Return a noisy frame of 9 stars, sigmas not all the same."""
    rng = np.random.default_rng(1)
    uv, sigma = rng.uniform(-500.0, 500.0, (9, 2)), SIGMA * rng.uniform(1.0, 2.0, 9)
    u_i = camera.unproject(uv, INTRINSICS, PITCH_MM) @ rotation.exp(rng.normal(size=3))
    return Stars(u_i, uv + sigma[:, None] * rng.standard_normal((9, 2)), sigma)


def angles(uv, lens):
    """Return the angles of all pairs behind a camera, the textbook way."""
    return between(camera.unproject(uv, lens, PITCH_MM))


def between(w):
    """Return the angles between all pairs of directions."""
    one, other = np.triu_indices(len(w), 1)
    return np.arccos(np.sum(w[one] * w[other], axis=-1))


def differences(function, steps):
    return np.stack([(function(step) - function(-step)) / (2.0 * step.sum())
                     for step in steps], axis=-1)


def literal(stars):
    """Return residuals of the angles, slopes by lens and by centroids: all by differences."""
    def by_uv(step):
        return angles(stars.uv + step.reshape(-1, 2), INTRINSICS)

    z = between(stars.u_i) - angles(stars.uv, INTRINSICS)
    lens_steps = np.diag([1.0, 1.0, 1e-2, 1e-6, 1e-8, 1e-6, 1e-6])
    A = -differences(lambda step: angles(stars.uv, INTRINSICS + step), lens_steps)
    J = differences(by_uv, 0.1 * np.eye(stars.uv.size))
    return z, A, J


def test_slopes_of_cosines_agree_with_central_differences():
    rng = np.random.default_rng(2)
    w, dw = rng.normal(size=(2, 5, 3)), rng.normal(size=(2, 5, 3, 4))
    slopes = angular_distance.slopes(w, dw)
    for k in range(4):
        h = 1e-6 * dw[..., k]
        numeric = (angular_distance.cosines(w + h) - angular_distance.cosines(w - h)) / 2e-6
        np.testing.assert_allclose(slopes[..., k], numeric, atol=1e-8)


def test_variances_are_those_of_many_draws():
    """A pair far apart, where the first order is all, and one that coincides, where it is none."""
    w = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, np.sqrt(0.99)], [0.0, 0.0, 1.0]])
    across = np.stack([np.eye(3)[:, :2] - np.outer(direction, direction[:2])
                       for direction in w])
    T = 1e-4 * across
    stated = angular_distance.variances(w, T)
    rng, draws = np.random.default_rng(3), 200_000
    noisy = w + (T @ rng.standard_normal((draws, 3, 2, 1)))[..., 0]
    noisy /= np.linalg.norm(noisy, axis=-1, keepdims=True)
    far, near = (np.var(np.sum(noisy[:, 0] * noisy[:, k], axis=-1)) for k in (1, 2))
    # The variance of n draws scatters by sqrt(2 / n) = 0.3 %, of an exponential law by 0.6 %.
    assert stated[0, 1] == pytest.approx(far, rel=0.015)
    assert stated[0, 2] == pytest.approx(near, rel=0.03)


def test_diagonal_weighting_is_that_of_the_angles_one_by_one(stars):
    z, A, J = literal(stars)
    sigma = np.linalg.norm(J * np.repeat(stars.sigma, 2), axis=1)
    expected = invariants.information(z / sigma, A / sigma[:, None])
    found = angular_distance.diagonal(invariants.linearize(stars, INTRINSICS, LENS))
    scale = np.sqrt(np.diag(expected.matrix))
    # Slopes at the measured places there and at fitted ones here: 0.1 px of 500, squared or not.
    np.testing.assert_allclose(found.matrix / np.outer(scale, scale),
                               expected.matrix / np.outer(scale, scale), atol=2e-3)
    np.testing.assert_allclose(found.vector / scale, expected.vector / scale, atol=0.01)


def test_full_weighting_is_the_pseudo_inverse_of_the_covariance_of_all_angles(stars):
    """W = (J sigma^2 J')^+ of rank 2 n - 3, written out for 36 angles of 9 stars."""
    z, A, J = literal(stars)
    covariance = (J * np.repeat(stars.sigma, 2)**2) @ J.T
    values = np.linalg.eigvalsh(covariance)[::-1]
    assert values[2 * 9 - 4] > 1e6 * abs(values[2 * 9 - 3])
    weight = np.linalg.pinv(covariance, rcond=np.sqrt(values[14] * abs(values[15])) / values[0],
                            hermitian=True)
    found = angular_distance.full(invariants.linearize(stars, INTRINSICS, LENS))
    scale = np.sqrt(np.diag(found.matrix))
    np.testing.assert_allclose(found.matrix / np.outer(scale, scale),
                               A.T @ weight @ A / np.outer(scale, scale), atol=2e-3)
    np.testing.assert_allclose(found.vector / scale, A.T @ weight @ z / scale, atol=0.01)


def test_angles_of_a_frame_without_noise_are_those_of_the_catalogue(stars):
    w = camera.unproject(stars.uv, INTRINSICS, PITCH_MM)
    exact = stars._replace(u_i=w @ rotation.exp(np.ones(3)))
    for weighting in (angular_distance.diagonal, angular_distance.full):
        matrix, vector = weighting(invariants.linearize(exact, INTRINSICS, LENS))
        np.testing.assert_allclose(vector / np.sqrt(np.diag(matrix)), 0.0, atol=1e-6)


def test_stars_that_coincide_do_no_harm(stars):
    doubled = Stars(*(np.concatenate((part, part[:1])) for part in stars))
    for weighting in (angular_distance.diagonal, angular_distance.full):
        matrix, vector = weighting(invariants.linearize(doubled, INTRINSICS, LENS))
        assert np.isfinite(matrix).all() and np.isfinite(vector).all()
        # what nine stars tell, and a little more
        alone = weighting(invariants.linearize(stars, INTRINSICS, LENS)).matrix
        assert (np.diag(matrix) >= np.diag(alone) * (1.0 - 1e-9)).all()


def test_both_weightings_take_batches(stars):
    uv = np.stack((stars.uv, stars.uv[::-1]))
    u_i = np.stack((stars.u_i, stars.u_i[::-1]))
    sigma = np.stack((stars.sigma, stars.sigma[::-1]))
    for weighting in (angular_distance.diagonal, angular_distance.full):
        batch = weighting(invariants.linearize(Stars(u_i, uv, sigma), INTRINSICS, LENS))
        alone = weighting(invariants.linearize(stars, INTRINSICS, LENS))
        for part, expected in zip(batch, alone):
            for run in range(2):        # in whatever order the stars stand
                np.testing.assert_allclose(part[run], expected, rtol=1e-6,
                                           atol=1e-9 * np.abs(expected).max())
