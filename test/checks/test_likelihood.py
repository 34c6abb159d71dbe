# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The likelihood of the band matrix is that of the whole one."""

import numpy as np
from scipy.linalg import block_diag

from starcal_ros.checks.likelihood import Comparison, StatedNoise
from starcal_ros.checks.turns import Turns
from starcal_ros.core import rotation

N, P = 14, 4


def turns(rng):
    stamp_ns = 10**9 * np.arange(N + 2)
    r = 0.02 * rng.standard_normal((N + 1, 3))
    roots = 1e-5 * rng.standard_normal((N + 2, 3, 3))
    R = roots @ np.swapaxes(roots, -1, -2)
    whole = Turns(stamp_ns[:-1], stamp_ns[1:], r, rotation.exp(r), R[:-1], R[1:],
                  np.ones(N + 1, bool))
    return whole.take(np.arange(N + 1) != 6)            # two chains


def dense(of, walk):
    V = block_diag(*(of.R_end + of.C @ of.R_begin @ np.swapaxes(of.C, -1, -2)
                     + walk**2 * of.dt[:, None, None] * np.eye(3)))
    for k in range(1, N):
        if of.chained[k]:
            low, high = slice(3 * k, 3 * k + 3), slice(3 * k - 3, 3 * k)
            V[low, high] = -of.C[k] @ of.R_end[k - 1]
            V[high, low] = V[low, high].T
    return V


def test_effects_and_likelihood_are_those_of_generalised_least_squares():
    rng = np.random.default_rng(3)
    of = turns(rng)
    assert of.chained.tolist() == [False] + [True] * 5 + [False] + [True] * 7
    X, y = rng.standard_normal((N, 3, P)), 1e-5 * rng.standard_normal((N, 3))
    comparison = Comparison(of, y, X, np.tile(np.eye(3), (N, 1, 1)),
                            np.full(P, np.inf))
    chosen = [0, 2, 3]
    for walk in (1e-6, 1e-5):
        V = dense(of, walk)
        A, b, inverse = X.reshape(-1, P)[:, chosen], y.ravel(), np.linalg.inv(V)
        covariance = np.linalg.inv(A.T @ inverse @ A)
        beta = covariance @ A.T @ inverse @ b
        left = b - A @ beta
        fit = comparison.fit(chosen, StatedNoise(walk))
        np.testing.assert_allclose(fit.beta, beta, rtol=1e-6)
        np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-6)
        np.testing.assert_allclose(fit.minus_2_log, left @ inverse @ left
                                   + np.linalg.slogdet(V)[1], rtol=1e-9)


def test_what_is_fitted_does_not_depend_on_what_was_fitted_before():
    rng = np.random.default_rng(5)
    given = (turns(rng), 1e-5 * rng.standard_normal((N, 3)), rng.standard_normal((N, 3, P)),
             np.tile(np.eye(3), (N, 1, 1)), np.full(P, np.inf))
    asked = Comparison(*given)
    for chosen in ([0], [1, 2], [0, 3], [2]):
        for noise in (StatedNoise(1e-5, 0.0, 1e-4), StatedNoise(1e-5, 1e-6, 1e-4)):
            for found, fresh in zip(asked.fit(chosen, noise),
                                    Comparison(*given).fit(chosen, noise)):
                np.testing.assert_allclose(found, fresh, rtol=1e-9)


def test_a_bias_that_walks_is_a_sum_of_waves():
    rng = np.random.default_rng(4)
    of = turns(rng)
    y = 1e-5 * rng.standard_normal((N, 3))
    comparison = Comparison(of, y, np.zeros((N, 3, 0)), np.tile(np.eye(3), (N, 1, 1)),
                            np.empty(0))
    walk, K = 1e-5, 3e-6
    since = of.since - of.since[0] + 0.5 * of.dt
    span = of.since[-1] - of.since[0] + of.dt[0]
    order = np.arange(32) + 0.5
    waves = np.sqrt(2.0) * np.sin(np.outer(since, order) * np.pi / span)
    covariance = K**2 * span * (waves / (order * np.pi)**2) @ waves.T
    V = dense(of, walk) + np.kron(covariance, np.eye(3))
    value = y.ravel() @ np.linalg.solve(V, y.ravel()) + np.linalg.slogdet(V)[1]
    np.testing.assert_allclose(
        comparison.fit([], StatedNoise(walk, K)).minus_2_log, value, rtol=1e-9)
    # As many waves are a random walk: of variance K^2 t, but for the first intervals.
    np.testing.assert_allclose(np.diag(covariance), K**2 * since, rtol=0.2)
