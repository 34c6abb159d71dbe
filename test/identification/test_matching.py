# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gate, one-to-one matching, fit and chance: against geometry, differences and counts."""

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import DETECTOR, INTRINSICS
from starcal_ros.core import rotation
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.identification.matching import (GATE, Expected, View, chance, expected, fitted,
                                                 match)

LENS = Tan2018Lens(DETECTOR.pitch_mm)
SIGMA = np.array([3.0, 3.0, 0.1, 1e-5, 1e-7, 1e-6, 1e-6])


def sky(rng: np.random.Generator, C_si, count: int):
    """Return directions u_i (count, 3) within 6 deg of the line of sight of an attitude."""
    r_s = np.column_stack((rng.uniform(-0.1, 0.1, (count, 2)), np.ones(count)))
    return (r_s / np.linalg.norm(r_s, axis=1, keepdims=True)) @ C_si


def view(attitude_sigma: float = 1e-3) -> View:
    """Return a view of an attitude without symmetries."""
    return View.around(rotation.exp(np.array([0.3, -1.0, 2.0])), attitude_sigma**2 * np.eye(3),
                       INTRINSICS, np.diag(SIGMA**2))


def stars_at(uv, P=0.0) -> Expected:
    """Return stars expected at uv with the same covariance P, (2, 2) or a variance."""
    uv = np.asarray(uv, float)
    P = P if np.ndim(P) == 2 else P * np.eye(2)
    return Expected(uv, np.zeros((len(uv), 2, 10)), np.broadcast_to(P, (len(uv), 2, 2)))


def test_the_derivatives_are_those_of_moving_the_view():
    at, h = view(), np.array([1e-6] * 3 + [1e-3, 1e-3, 1e-4, 1e-7, 1e-9, 1e-8, 1e-8])
    u_i = sky(np.random.default_rng(1), at.C_si, 8)
    H = expected(at, u_i, LENS).H
    # `moved` takes an error away: d uv / d(estimate) is minus its derivative.
    numeric = np.stack([(expected(at.moved(-step), u_i, LENS).uv
                         - expected(at.moved(step), u_i, LENS).uv) / (2.0 * h[k])
                        for k, step in enumerate(np.diag(h))], axis=-1)
    largest = np.abs(numeric).max(axis=(0, 1))
    np.testing.assert_allclose(H / largest, numeric / largest, atol=1e-5)


def test_moving_and_subtracting_are_inverse():
    error = np.array([1e-3, -2e-3, 5e-4, 1.0, -2.0, 0.1, 1e-5, 1e-7, -1e-6, 2e-6])
    np.testing.assert_allclose(view().minus(view().moved(error)), error, rtol=1e-9, atol=1e-16)


def test_the_covariance_of_a_singular_camera_is_kept():
    covariance = np.zeros((7, 7))
    covariance[:2, :2] = [[4.0, 4.0], [4.0, 4.0]]          # two errors that are one
    root = View.around(np.eye(3), np.eye(3), INTRINSICS, covariance).root
    np.testing.assert_allclose((root @ root.T)[3:, 3:], covariance, atol=1e-14)


def test_images_of_stars_pass_the_gate_as_often_as_chi_square_says():
    rng, count = np.random.default_rng(2), 20_000
    P = np.array([[4.0, 1.5], [1.5, 1.0]])
    uv = 1000.0 * np.column_stack((np.arange(count), np.zeros(count)))  # each far from the next
    spots = (uv + rng.standard_normal((count, 2)) @ np.linalg.cholesky(P).T
             + 0.5 * rng.standard_normal((count, 2)))
    lost = count - sum(
        len(match(stars_at(uv[k:k + 500], P), spots[k:k + 500], np.full(500, 0.5))[0])
        for k in range(0, count, 500))
    assert GATE == pytest.approx(chi2.ppf(0.999, 2))
    # 20 are expected; Poisson's 99.9 % interval
    assert 8 <= lost <= 36


def test_the_nearest_is_not_enough_where_two_stars_may_be_meant():
    spot, star = match(stars_at([[0, 0], [1, 0], [50, 50]]), np.array([[0.1, 0], [50, 50]]),
                       np.full(2, 0.5))
    assert spot.tolist() == [1] and star.tolist() == [2]


def test_two_spots_on_one_star_are_both_left_out():
    spot, star = match(stars_at([[0, 0], [50, 50]]), np.array([[0.1, 0], [-0.2, 0], [50, 50]]),
                       np.full(3, 0.5))
    assert spot.tolist() == [2] and star.tolist() == [1]


def test_the_gate_of_a_star_is_wide_where_its_image_is_uncertain():
    along_u = np.diag([100.0, 0.0])
    spots = np.array([[20.0, 0.0], [500.0, 20.0]])
    spot, _ = match(stars_at([[0, 0], [500, 0]], along_u), spots, np.full(2, 0.5))
    assert spot.tolist() == [0]


def test_a_fit_to_perfect_stars_is_the_truth():
    truth = view()
    prior = truth.moved(np.array([2e-3, -1e-3, 3e-3, 2.0, -3.0, 0.2, 1e-5, -1e-7, 1e-6, 1e-6]))
    u_i = sky(np.random.default_rng(3), truth.C_si, 40)
    uv = expected(truth, u_i, LENS).uv
    found = fitted(prior, u_i, uv, np.full(40, 1e-3), LENS)
    np.testing.assert_allclose(expected(found, u_i, LENS).uv, uv, atol=1e-3)


def test_the_covariance_of_a_fit_is_that_of_its_errors():
    truth, rng, nees = view(), np.random.default_rng(4), []
    sigma = np.full(12, 0.5)
    for _ in range(200):
        prior = truth.moved(-truth.root @ rng.standard_normal(10))
        u_i = sky(rng, truth.C_si, 12)
        uv = expected(truth, u_i, LENS).uv + 0.5 * rng.standard_normal((12, 2))
        found = fitted(prior, u_i, uv, sigma, LENS)
        nees.append(np.sum(np.linalg.solve(found.root, found.minus(truth))**2))
    # The robust weights cost a little: 1 / (1 + x^2 / 9)^2 of a miss of x sigma, on average 0.7
    # of each star; the sigmas of the fit say so too.
    low, high = chi2.ppf([0.0005, 0.9995], 200 * 10) / 200
    assert 0.8 * low < np.mean(nees) < high


def test_a_fit_lets_go_of_a_star_that_is_another():
    truth = view()
    prior = truth.moved(np.array([2e-3, -2e-3, 0, 0, 0, 0, 0, 0, 0, 0]))
    u_i = sky(np.random.default_rng(5), truth.C_si, 15)
    uv = expected(truth, u_i, LENS).uv
    uv[:3] += [12.0, -9.0]
    found = fitted(prior, u_i, uv, np.full(15, 0.3), LENS)
    miss = np.linalg.norm(expected(found, u_i, LENS).uv - uv, axis=1)
    assert miss[3:].max() < 0.3         # a sigma; the plain fit would be 3 px off


def test_random_spots_match_as_often_as_poisson_says():
    rng, n_stars, spots = np.random.default_rng(6), 50, 10
    stars = stars_at(rng.uniform(-450.0, 450.0, (n_stars, 2)), 12.0)
    counts = np.array([len(match(stars, rng.uniform(-512.0, 512.0, (spots, 2)),
                                 np.full(spots, 1.0))[0]) for _ in range(3000)])
    mean = spots * n_stars * np.pi * GATE * 13.0 / 1024.0**2
    # Two gates of radius r overlap where their centres are within 2 r, 4 times the area of one:
    # up to 4 n a / A = 11 % of the gates' area counts less, and so do two spots in one gate.
    assert 0.85 * mean < counts.mean() < mean + 3.3 * np.sqrt(mean / 3000)
    two = chance(2, spots, stars, 1.0, DETECTOR)
    assert 0.85**2 * two - 3.3 * np.sqrt(two / 3000) < np.mean(counts >= 2) < two + 3.3 * np.sqrt(
        two / 3000)
