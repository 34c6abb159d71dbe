# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Singular values: the camera from those of the directions to groups of stars of a frame.

Model
-----
The directions of some stars of a frame, as rows of a matrix W, have the Gram matrix G = W' W. Its
eigenvalues are the squares of W's singular values sigma_1 >= sigma_2 >= sigma_3. A rotation turns
the eigenvectors p_k alone, so the singular values are those of the catalogue (W19 Eq. 14 to 20) ::

    d sigma_k = p_k' dG p_k / (2 sigma_k) = sum_j (p_k . w_j) (p_k . d w_j) / sigma_k       (V.1)

Groups
------
Stars are taken in the order of the message; W19 does not say how it numbers them. Of N stars ::

    Model 1    three neighbours: 123, 234, ...
    Model 2    N/2 neighbours, rounded down, three at least
    Model 3    all but one
    Model 4    the first three, four, ... N                                 (W19 Sec. 3.3.2)

Second order
------------
A singular value that vanishes, as of three stars on a great circle, or that all but equals
another, is not linear in the centroids over their noise. With v the variance of a direction, each
axis, m stars and lambda = sigma^2, what (V.1) leaves out has the variance ::

    v^2 / (2 lambda_k) (m - 1 + 2 sum_l lambda_k (lambda_k + lambda_l) / (lambda_k - lambda_l)^2)
                                                                                        (V.2)

by second-order perturbation, which gives m - 3: the sigma_3 of three stars is linear, being the
volume between them, but for its sign. It is added to the variance of each singular value, so that
one that tells nothing loses its weight by degrees.

Weighting
---------
diagonal
    As published: each singular value is weighted as if it were independent of all others.
full
    The covariance of all of them, J sigma^2 J' with J the slopes by the centroids, and (V.2).
"""

from __future__ import annotations

from functools import cache, partial

import numpy as np
from scipy.linalg.lapack import dposv

from starcal_ros.calibration.attitude_free import AttitudeFree
from starcal_ros.calibration.frame_arithmetic import kernel
from starcal_ros.calibration.invariants import Frame, Information, direction_slopes, directions
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera_estimate import CameraEstimate

MIN_STARS = 3

_NEVER = 1e12           # variance of what is excluded; that of a direction is about 1e-8
_LEAST = 1e-12          # singular value below which it is zero
_ITSELF = np.diag([np.inf] * 3)


def start(scenario: Scenario, known: CameraEstimate | None = None) -> AttitudeFree:
    """Begin a calibration with the scenario's model, singular values and weighting.

    Raises
    ------
    ConfigError
        Where no singular value is chosen, or one twice.
    """
    options = scenario.intrinsics
    chosen = options.singular_values
    if not chosen or len(set(chosen)) < len(chosen):
        raise ConfigError(f'intrinsics.singular_values: got {list(chosen)}, needs one at least of '
                          '1, 2, 3, and each once')
    return AttitudeFree(scenario, partial(
        measure, model=options.combination_model, chosen=chosen,
        full=options.weighting == 'full'), MIN_STARS, known)


@cache
def groups(model: int, n: int) -> Array:
    """Return which of n stars are in which of m groups, (m, n): 1 where one is, 0 elsewhere."""
    if model == 3:
        return 1.0 - np.eye(n)
    if model == 4:
        return np.tri(max(n - 2, 0), n, 2)
    size = 3 if model == 1 else max(n // 2, 3)
    return np.tri(max(n - size + 1, 0), n, size - 1) - np.tri(max(n - size + 1, 0), n, -1)


@cache
def _ascending(chosen: tuple[int, ...]) -> slice:
    """Return where numpy, which has the smallest first, has the chosen singular values."""
    first, last = 3 - max(chosen), 3 - min(chosen)
    return slice(first, last + 1, max(1, (last - first) // max(1, len(chosen) - 1)))


def gram(member: Array, w: Array) -> Array:
    """Return the Gram matrices, (..., m, 3, 3), of groups of directions.

    Parameters
    ----------
    member : (m, n) array
        1 where a direction is in a group, 0 elsewhere.
    w : (..., n, 3) array
        Unit directions.
    """
    squares = (w[..., :, None] * w[..., None, :]).reshape(*w.shape[:-1], 9)
    return (member @ squares).reshape(*w.shape[:-2], len(member), 3, 3)


def slopes(member: Array, w: Array, p: Array, sigma: Array, dw: Array) -> Array:
    """Return the derivatives of singular values by what moves each direction alone, Eq. (V.1).

    Parameters
    ----------
    member, w
        As for `gram`.
    p : (..., m, 3, k) array
        Eigenvectors of their Gram matrices.
    sigma : (..., m, k) array
        Singular values, not zero.
    dw : (..., n, 3, c) array
        Derivatives of each direction by its own c variables.

    Returns
    -------
    derivatives : (..., m, k, n, c) array
    """
    n, c = dw.shape[-3], dw.shape[-1]
    rows = np.swapaxes(p, -1, -2).reshape(*p.shape[:-3], -1, 3)
    along = (rows / sigma.reshape(*rows.shape[:-1], 1)) @ np.swapaxes(w, -1, -2)
    along = along.reshape(*sigma.shape, n) * member[:, None, :]
    beside = rows @ np.swapaxes(dw, -3, -2).reshape(*dw.shape[:-3], 3, n * c)
    return along[..., None] * beside.reshape(*along.shape, c)


def second_order(eigenvalues: Array, count: Array, variance: Array) -> Array:
    """Return the variance of what is not linear in the singular values, (..., 3), Eq. (V.2).

    Parameters
    ----------
    eigenvalues : (..., 3) array
        Squares of the singular values, not zero.
    count, variance : (...) array
        Number of stars, and the variance of a direction, each axis.
    """
    one, other = eigenvalues[..., :, None], eigenvalues[..., None, :]
    coupling = one * (one + other) / ((one - other + _ITSELF)**2 + _LEAST**4)
    factor = (count - 1.0)[..., None] + 2.0 * np.add.reduce(coupling, axis=-1)
    return np.minimum((0.5 * variance**2)[..., None] * factor / eigenvalues, _NEVER)


def measure(frame: Frame, model: int, chosen: tuple[int, ...], full: bool) -> Information:
    """Return what the singular values of a frame tell of the parameters.

    Parameters
    ----------
    frame : Frame
        Of three stars or more.
    model : int
        Star combination model, 1 to 4.
    chosen : tuple of int
        Singular values, 1 the largest.
    full : bool
        Weight them by their whole covariance; else by their variances.
    """
    member = groups(model, frame.r_s.shape[-2])
    count = np.add.reduce(member, axis=-1)
    order = _ascending(chosen)
    rows = (*frame.z.shape[:-1], -1)
    if kernel and frame.z.ndim == 1:
        both, B, beyond = kernel.singular_values(member, np.arange(3)[order], frame.r_s, frame.z,
                                                 frame.H, frame.N, _LEAST, _NEVER)
        return _weighted(both, B, beyond, full)
    T = direction_slopes(frame)
    eigenvalues, p = np.linalg.eigh(gram(member, frame.r_s))
    eigenvalues = np.maximum(eigenvalues, _LEAST**2)
    measured = np.linalg.eigvalsh(gram(member, directions(frame, T)))
    sigma = np.sqrt(eigenvalues)
    z = (sigma - np.sqrt(np.maximum(measured, 0.0)))[..., order]
    variance = 0.5 * np.einsum('...jab,...jab->...j', T, T) @ member.T / count
    beyond = second_order(eigenvalues, count, variance)[..., order]
    B = slopes(member, frame.r_s, p[..., order], sigma[..., order], T)
    B = B.reshape(*rows, frame.z.shape[-1])
    both = np.concatenate((z.reshape(*rows, 1), B @ frame.H), axis=-1)
    return _weighted(both, B, beyond.reshape(rows), full)


def _weighted(both: Array, B: Array, beyond: Array, full: bool) -> Information:
    """Return the information of residuals and slopes side by side, (..., m, 1 + p)."""
    if full:
        S = B @ np.swapaxes(B, -1, -2)
        S.reshape(*beyond.shape[:-1], -1)[..., ::S.shape[-1] + 1] += beyond
        weighted = _solved(S, both)
    else:
        weighted = both / (np.sum(B * B, axis=-1) + beyond)[..., None]
    both = np.swapaxes(both[..., 1:], -1, -2) @ weighted
    return Information(both[..., 1:], both[..., 0])


def _solved(S: Array, b: Array) -> Array:
    """Return S^-1 b of positive definite S; a single one takes LAPACK half of the time."""
    if S.ndim > 2 or not len(S):
        return np.asarray(np.linalg.solve(S, b), float)
    _, solved, failed = dposv(S, b)
    if failed:
        raise np.linalg.LinAlgError('the covariance of the singular values has no root')
    return np.asarray(solved, float)
