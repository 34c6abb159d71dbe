# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The likelihood of the turns for effects that are linear and noises that are Gaussian.

With y what the stars turned beyond what the gyros say, and V its block tridiagonal covariance by
Eq. (K.2) of `turns` ::

    y = X beta + Z u + e,    e ~ N(0, V),    u ~ N(0, K^2 Lambda)                        (K.3)
    V_kk   = R_k + C_k R_k-1 C_k' + N^2 dt I + T^2 w_k w_k' + T^2 w_k-1 w_k-1'
    V_k,k+1 = -(R_k + T^2 w_k w_k') C_k+1'

    X  effects that are either there or not
    Z  a bias that walks: its first waves over the recording (Karhunen and Loeve)
    N  rad/sqrt(s)      angular random walk
    K  rad/s/sqrt(s)    random walk of the bias
    T  s                scatter of the stamps, w the rate of the camera

V is factorised as a band matrix; all columns are whitened once for each N and T, and what
follows are sums of squares. The likelihood is that of the most likely beta.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky_banded
from scipy.linalg.lapack import dtbtrs

from starcal_ros.checks.turns import Turns
from starcal_ros.core.arrays import Array, Ints

WAVES = 32
"""Of a bias that walks."""
_BAND = 5               # below the diagonal


class StatedNoise(NamedTuple):
    """N, K and T of Eq. (K.3), in SI units."""

    walk: float
    bias_walk: float = 0.0
    stamps: float = 0.0


class EffectSizes(NamedTuple):
    """The most likely effects.

    Attributes
    ----------
    beta : (p,) array
    covariance : (p, p) array
    minus_2_log : float
        Minus twice the logarithm of the likelihood, but for a constant.
    """

    beta: Array
    covariance: Array
    minus_2_log: float


class Comparison:
    """What is left of the turns, and the effects that may explain it.

    Parameters
    ----------
    turns : Turns
    y : (n, 3) array
        Turn by the stars less that by the gyros [rad].
    columns : (n, 3, p) array
        What one unit of each effect adds to y.
    bias_turn : (n, 3, 3) array
        What a bias adds to y [s].
    prior : (p,) array
        Sigma of each effect, about 0, before anything is compared; infinite for none.
    """

    def __init__(self, turns: Turns, y: Array, columns: Array, bias_turn: Array, prior: Array
                 ) -> None:
        self._turns, self._prior = turns, prior**-2.0
        self._count = columns.shape[-1]
        span = float(turns.since[-1] - turns.since[0]) + float(turns.dt[0])
        since = turns.since - turns.since[0] + 0.5 * turns.dt
        order = np.arange(WAVES) + 0.5
        waves = np.sqrt(2.0) * np.sin(order * np.pi * since[:, None] / span)
        root = np.sqrt(span) * 1.0 / (order * np.pi)    # of the variance, for K = 1
        Z = (bias_turn[:, :, :, None] * (waves * root)[:, None, None]).reshape(len(y), 3, -1)
        self._W = np.concatenate((columns, Z, y[..., None]), axis=-1).reshape(3 * len(y), -1)
        self._band = _Band(turns)
        self._whitened: dict[tuple[float, float], tuple[Array, float]] = {}
        self._asked: set[tuple[float, float]] = set()

    def fit(self, chosen: Sequence[int], noise: StatedNoise) -> EffectSizes:
        """Return the most likely sizes of some of the effects."""
        p, last = self._count, self._W.shape[1] - 1
        rows = [*chosen, *(range(p, last) if noise.bias_walk else ())]
        G, log_det = self._gram(noise.walk, noise.stamps, [*rows, last])
        N = G[:-1, :-1].copy()
        extra = len(rows) - len(chosen)
        N[range(len(chosen)), range(len(chosen))] += self._prior[list(chosen)]
        if extra:
            ridge = np.diag(np.r_[np.zeros(len(chosen)), np.full(extra, noise.bias_walk**-2.0)])
            Z = slice(len(chosen), None)
            log_det += float(np.linalg.slogdet(
                np.eye(extra) + noise.bias_walk**2 * N[Z, Z])[1])
            N += ridge
        size = np.sqrt(np.maximum(np.diag(N), 1e-300))
        scaled = N / np.outer(size, size) + 1e-12 * np.eye(len(rows))
        inverse = np.linalg.inv(scaled) / np.outer(size, size)
        beta = inverse @ G[:-1, -1]
        left = float(G[-1, -1] - G[:-1, -1] @ beta)
        m = len(chosen)
        return EffectSizes(beta[:m], inverse[:m, :m], left + log_det)

    def outliers(self, chosen: Sequence[int], noise: StatedNoise, count: int) -> Ints:
        """Return the intervals that some effects explain least, `count` of them at most."""
        fit = self.fit(chosen, noise)
        left = self._W[:, -1] - self._W[:, list(chosen)] @ fit.beta
        V = self._band.of(noise.walk, noise.stamps)[0]
        misfit = np.sum((left**2 / V).reshape(-1, 3), axis=-1)
        return np.sort(np.argsort(-misfit, kind='stable')[:count]).astype(np.int64)

    def _gram(self, walk: float, stamps: float, columns: list[int]) -> tuple[Array, float]:
        """Return the products of some of the whitened columns, and the logarithm of |V|.

        A noise that is tried once has these whitened alone, one that is asked for again all.
        """
        key = walk, stamps
        if key not in self._whitened:
            L = cholesky_banded(self._band.of(walk, stamps), lower=True)
            log_det = 2.0 * float(np.log(L[0]).sum())
            if key not in self._asked:
                self._asked.add(key)
                W, _ = dtbtrs(L, self._W[:, columns], uplo='L')
                return W.T @ W, log_det
            if len(self._whitened) > 64:
                self._whitened.clear()
            W, _ = dtbtrs(L, self._W, uplo='L')
            self._whitened[key] = W.T @ W, log_det
        G, log_det = self._whitened[key]
        return G[np.ix_(columns, columns)], log_det


class _Band:
    """V of Eq. (K.3) in the lower form of a band matrix, (6, 3 n), for any N and T.

    Parameters
    ----------
    turns : Turns
    """

    def __init__(self, turns: Turns) -> None:
        self._attitudes = _of_ends(turns, turns.R_begin, turns.R_end)
        self._walk = np.repeat(turns.dt, 3)
        rate = turns.r / turns.dt[:, None]
        joined = turns.chained[1:, None]
        w_end, w_begin = rate.copy(), rate.copy()       # of the camera at both ends
        mean = 0.5 * (rate[1:] + rate[:-1])
        w_end[:-1] = np.where(joined, mean, rate[:-1])
        w_begin[1:] = np.where(joined, mean, rate[1:])
        self._stamps = _of_ends(turns, *(w[:, :, None] * w[:, None, :] for w in (w_begin, w_end)))

    def of(self, walk: float, stamps: float) -> Array:
        """Return it for N and T."""
        band = self._attitudes + stamps**2 * self._stamps
        band[0] += walk**2 * self._walk
        return band


def _of_ends(turns: Turns, R_begin: Array, R_end: Array) -> Array:
    """Return what covariances of the two ends of the intervals, (n, 3, 3), give V."""
    n, C = len(turns), turns.C
    V = R_end + C @ R_begin @ np.swapaxes(C, -1, -2)
    below = np.zeros((n, 3, 3))         # rows of interval k + 1, columns of k
    below[:-1] = -(C[1:] @ R_end[:-1]) * turns.chained[1:, None, None]
    full = np.concatenate((V, below), axis=1)           # (n, 6, 3): the columns of an interval
    band = np.zeros((_BAND + 1, n, 3))
    for column in range(3):
        depth = min(6 - column, _BAND + 1)
        band[:depth, :, column] = full[:, column:column + depth, column].T
    return band.reshape(_BAND + 1, 3 * n)
