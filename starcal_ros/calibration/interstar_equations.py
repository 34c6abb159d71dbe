# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Equations of the interstar angles: a camera from spots alone, or from identified stars (S24).

Model
-----
Spot i of frame m lies in direction w_mi, in s. Whatever the attitude, the cosine of the angle
between two stars is that of the sky (T) or, where no star is identified, the same in any two
frames (S) ::

    e_mij  = w_mi . w_mj - v_i . v_j                         i < j              (T: S24 Eq. 4)
    e_mnij = w_mi . w_mj - w_ni . w_nj                       i < j, m < n       (S: S24 Eq. 5, 8)

Non-linear least squares, scaled by lambda (S24 Eq. 10-13) ::

    X <- X - lambda (A'A)^-1 A'e,        A_k = b_mik . w_mj + w_mi . b_mjk - (the same of n)  (I.1)

with b_k the derivative of w by the k-th intrinsic. For a pinhole camera ``q = (u0 - u, v0 - v)``
in mm and f, ``w = q / r``, and without constraint (OC) or with r held (WC, S24 Eq. 9, 13) ::

    OC  b_k = (I - w w') dq/dX_k / r            WC  b_k = dq/dX_k / r                         (I.2)

WC is no least squares: its A is not the derivative of e. It solves ``A'e = 0`` with A as
instruments, and Newton's matrix for that is ``A' de/dX``, which needs no lambda.

Without constraint the noise of a spot is in A and in e alike, so A'e does not vanish on average:
f is biased, in S by a hundred um. With r held most of A is free of noise, and so is f of bias. But
the expectation of A'e is known (`bias`) and can be subtracted (corrected score; T. Nakamura,
Biometrika 77, 1990): f is then free of bias without constraint, and stays accurate when
distortion is estimated, where the instruments of WC hardly tell f from k1.

Reduction
---------
Of numbers q_m seen in n frames, the sum over pairs of frames is n times the centred sum ::

    sum_{m<n} (q_m - q_n)^2 = n sum_m (q_m - mean q)^2                                        (I.3)

and likewise for A'A and A'e. And what is left, sums over pairs of stars of products of scalar
products, are sums over stars of moments of w and b: with n_ij the frames in which both stars
were seen (1 in T) and s_ij the sum over them of w_mi . w_mj (v_i . v_j in T), V_mi = sum_j
(n_ij w_mi . w_mj - s_ij) w_mj and ``A'e = sum_mi b_mi . V_mi``, where ``sum_j n_ij w_mj w_mj'`` is
one 3x3 matrix a frame. No pair of stars of a frame is ever formed: NF NS^2 operations of matrix
products in S, NF NS in T, in place of NF^2 NS^2.

Arrays
------
The axes are ``(..., NF, NS)``: rounds or windows, frames, spots. Components (3) and intrinsics (K)
come before them, so that the inner loops run over the spots.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from starcal_ros.core import camera
from starcal_ros.core.arrays import Array, Mask

CONVERGED = 1e-8        # step, in parts of the largest, with which an iteration ends
_BEND_PX = 0.01         # step of a numeric derivative, whose error is its square over f


class SpotDirections(NamedTuple):
    """Directions of spots, and what moves them; zero for a spot that was not seen.

    Attributes
    ----------
    w : (3, ..., NF, NS) array
        Unit vectors, in s.
    by_intrinsics : (K, 3, ..., NF, NS) array
        Derivative by the intrinsics that are estimated.
    instruments : (K, 3, ..., NF, NS) array
        b of Eq. (I.2): what the equations take for that derivative.
    by_spot : (2, 3, ..., NF, NS) array
        Derivative by the place of the spot, u and v [1/px].
    """

    w: Array
    by_intrinsics: Array
    instruments: Array
    by_spot: Array


class Equations(NamedTuple):
    """The equations A'e = 0 at some camera.

    Attributes
    ----------
    value : (..., K) array
        A'e.
    by_direction : (K, 3, ..., NF, NS) array
        Derivative of the value by each w, at vanishing e.
    """

    value: Array
    by_direction: Array

    def product(self, moved: Array) -> Array:
        """Return the derivative of the value, (..., K, L), by what moves w by (L, 3, ...)."""
        return np.einsum('ka...ms,la...ms->...kl', self.by_direction, moved)

    def noise(self, by_spot: Array, sigma: Array | float) -> Array:
        """Return the covariance of the value, (..., K, K), for spots of sigma (..., NF, NS) [px].

        To first order: without what the products of the noises add.
        """
        moved = np.einsum('ka...ms,la...ms->kl...ms', self.by_direction, by_spot) * sigma
        return np.einsum('kl...ms,jl...ms->...kj', moved, moved)


class Bias(NamedTuple):
    """What the noise of the spots does to the equations of S on average, to second order.

    Attributes
    ----------
    value : (..., K) array
        Expectation of A'e at the true camera.
    squares : (...) array
        Sum of e squared that there is.
    expected : (...) array
        Its expectation at the true camera, for the noise as stated.
    variance : (...) array
        Its variance, but for a part of 1/NS or so.
    """

    value: Array
    squares: Array
    expected: Array
    variance: Array


def pinhole(uv: Array, intrinsics: Array, pitch_mm: float, constrained: bool) -> SpotDirections:
    """Return where a pinhole camera sees the spots.

    Parameters
    ----------
    uv : (..., NF, NS, 2) array
        Spots, from where the intrinsics count [px].
    intrinsics : (..., 3) array
        u0, v0 [px] and f [mm].
    pitch_mm : float
        Pixel pitch [mm].
    constrained : bool
        Hold r, Eq. (I.2), WC.
    """
    u0, v0, f = (intrinsics[..., k, None, None] for k in range(3))
    w = np.empty((3, *uv.shape[:-1]))
    w[0], w[1], w[2] = (u0 - uv[..., 0]) * pitch_mm, (v0 - uv[..., 1]) * pitch_mm, f
    along = 1.0 / np.sqrt(np.einsum('a...,a...->...', w, w))
    w *= along
    unit = (pitch_mm, pitch_mm, 1.0)
    by_intrinsics = np.empty((3, *w.shape))
    for k in range(3):
        np.multiply(w, (-unit[k] * along) * w[k], out=by_intrinsics[k])
        by_intrinsics[k, k] += unit[k] * along
    instruments = by_intrinsics
    if constrained:
        instruments = np.zeros_like(by_intrinsics)
        for k in range(3):
            np.multiply(along, unit[k], out=instruments[k, k])
    return SpotDirections(w, by_intrinsics, instruments, -by_intrinsics[:2])


def lens(uv: Array, intrinsics: Array, pitch_mm: float, estimated: Sequence[int],
         constrained: bool, seen: Mask) -> SpotDirections:
    """Return where any camera sees the spots, as `pinhole`, its distortion taken off exactly.

    Parameters
    ----------
    uv : (..., NF, NS, 2) array
        Spots, from the detector's centre [px].
    intrinsics : (..., 7) array
        Camera, as in `starcal_ros.core.camera`: one for all spots, or one a round.
    pitch_mm : float
        Pixel pitch [mm].
    estimated : sequence of int
        Which of the seven are estimated.
    constrained : bool
        Hold r, now the optical path to the undistorted spot.
    seen : (..., NF, NS) bool array
        Spots that were seen.
    """
    each = intrinsics if intrinsics.ndim == 1 else np.broadcast_to(
        intrinsics[..., None, None, :], (*seen.shape, 7))[seen][:, None]
    parts = camera.backproject(uv[seen].reshape(*each.shape[:-1], -1, 2), each, pitch_mm)
    w, by_spot, by_intrinsics = (_scattered(part.reshape(seen.sum(), 3, -1)[..., columns], seen)
                                 for part, columns in zip(parts, ([0], [0, 1], [*estimated])))
    w, instruments = w[0], by_intrinsics
    if constrained:
        # q = r w and q_z = f: what was lost along w is dr / r = df / f - dw_z / w_z.
        stretch = -by_intrinsics[:, 2] / np.where(seen, w[2], 1.0)
        if 2 in estimated:
            stretch[list(estimated).index(2)] += 1.0 / intrinsics[..., 2, None, None]
        instruments = by_intrinsics + stretch[:, None] * w
    return SpotDirections(w, by_intrinsics, instruments, by_spot)


def _scattered(rows: Array, seen: Mask) -> Array:
    """Return rows (spots, 3, K) as (K, 3, ..., NF, NS), zero where no spot was seen."""
    out = np.zeros((rows.shape[2], 3, *seen.shape))
    out[..., seen] = rows.T
    return out


def equations(sight: SpotDirections, cosines: Array | None = None, seen: Mask | None = None
              ) -> Equations:
    """Return the equations of the interstar angles, the sums over all pairs done.

    Parameters
    ----------
    sight : SpotDirections
        From `pinhole` or `lens`.
    cosines : (..., NS, NS) array, optional
        v_i . v_j of the catalogue; without it the frames are compared with one another.
    seen : (..., NF, NS) bool array, optional
        Spots that were seen, if not all; a pair counts in the frames that show both.
    """
    w, b = sight.w, sight.instruments
    counts, moment, residual = joined(w, cosines, seen)
    by_direction = np.einsum('ac...ms,kc...ms->ka...ms', moment, b)
    by_direction += np.einsum('kac...ms,c...ms->ka...ms', _summed(w, b, counts), w)
    if cosines is None:
        mean = np.sum(np.swapaxes(b, -1, -2) @ w, axis=1)
        by_direction -= w @ (mean + np.swapaxes(mean, -1, -2))[:, None]
    if b is not sight.by_intrinsics:
        # A spot makes no pair with itself: its b along w must not count; without r held it is 0.
        own = np.einsum('ka...ms,a...ms->k...ms', b, w)
        if cosines is None:
            each = counts if isinstance(counts, int) else np.diagonal(
                counts, axis1=-2, axis2=-1)[..., None, :]
            own = each * own - own.sum(axis=-2, keepdims=True)
        by_direction -= 2.0 * own[:, None] * w
    return Equations(np.einsum('ka...ms,a...ms->...k', b, residual), by_direction)


def covariance(matrix: Array, noise: Array) -> Array:
    """Return the covariance, (..., K, K), of a camera that solves the equations: M^-1 N M^-T.

    They are not those of maximum likelihood, so that M alone says nothing of the error.

    Parameters
    ----------
    matrix : (..., K, K) array
        M, the derivative of the value: `Equations.product` of `SpotDirections.by_intrinsics`.
    noise : (..., K, K) array
        N, the covariance of the value: `Equations.noise`.
    """
    half = np.linalg.solve(matrix, noise)
    return np.asarray(np.linalg.solve(matrix, np.swapaxes(half, -1, -2)))


def bias(look: Callable[[Array], SpotDirections], uv: Array, sigma: Array | float,
         seen: Mask | None = None) -> Bias:
    """Return the expectation of the equations of S, r not held.

    A spot moved by d changes its b by b' d and its w by t d. Of a pair in one of n_ij frames A
    changes by ``b_i' d . w_j + b_j . t_i d``, n_ij e by ``(n_ij - 1) t_i d . w_j``.

    Parameters
    ----------
    look : callable
        From spots to their `SpotDirections`: `pinhole` or `lens` at some camera, not constrained.
    uv : (..., NF, NS, 2) array
        Spots [px].
    sigma : (..., NF, NS) array or float
        Standard deviation of the spots, each axis [px].
    seen : (..., NF, NS) bool array, optional
        As for `equations`.
    """
    sight = look(uv)
    w, b, t = sight.w, sight.instruments, sight.by_spot
    counts, moment, residual = joined(w, None, seen)
    moment = moment - _summed(w, w[None], 1)[0]
    crossed = _summed(w, b, counts) - _summed(w, b, 1)
    variance = np.broadcast_to(np.square(sigma), w.shape[1:])
    pulled = np.einsum('ac...ms,kc...ms->ka...ms', moment, t)
    value = np.einsum('kac...ms,la...ms,lc...ms,...ms->...k', crossed, t, t, variance,
                      optimize=True)
    for k, step in enumerate(_BEND_PX * np.eye(2)):
        bend = (look(uv + step).instruments - b) / _BEND_PX
        value += np.einsum('ka...ms,a...ms,...ms->...k', bend, pulled[k], variance)
    own = np.einsum('ka...ms,la...ms->kl...ms', t, pulled) * variance
    return Bias(value, 0.5 * np.einsum('a...ms,a...ms->...', w, residual),
                np.einsum('kk...ms->...', own), 2.0 * np.einsum('kl...ms,kl...ms->...', own, own))


def misfit(sight: SpotDirections, cosines: Array | None = None, seen: Mask | None = None) -> Array:
    """Return how far each spot is from where its pairs want it, (..., NF, NS, 2) [px].

    The shift of one spot, all others held, that minimises the sum of its e squared.
    """
    w, t = sight.w, sight.by_spot
    _, moment, residual = joined(w, cosines, seen)
    N = np.einsum('ka...ms,ac...ms,lc...ms->...mskl', t, moment, t)
    z = np.einsum('ka...ms,a...ms->...msk', t, residual)
    determinant = N[..., 0, 0] * N[..., 1, 1] - N[..., 0, 1]**2
    lonely = determinant <= 1e-12 * N[..., 0, 0] * N[..., 1, 1]
    shift = np.stack((N[..., 1, 1] * z[..., 0] - N[..., 0, 1] * z[..., 1],
                      N[..., 0, 0] * z[..., 1] - N[..., 0, 1] * z[..., 0]), axis=-1)
    return np.where(lonely[..., None], 0.0, shift / np.where(lonely, 1.0, determinant)[..., None])


def joined(w: Array, cosines: Array | None, seen: Mask | None
           ) -> tuple[Array | int, Array, Array]:
    """Return n_ij, one number where all are the same, sum_j n_ij w_j w_j' and V of Eq. (I.3)."""
    counts: Array | int = 1
    if cosines is None:
        cosines = np.sum(np.swapaxes(w, -1, -2) @ w, axis=0)            # summed over the frames
        counts = w.shape[-2]
        if seen is not None:
            weight = seen.astype(float)
            counts = np.swapaxes(weight, -1, -2) @ weight
    moment = _summed(w, w[None], counts)[0]
    return counts, moment, np.einsum('ac...ms,c...ms->a...ms', moment, w) - w @ cosines


def _summed(w: Array, b: Array, counts: Array | int) -> Array:
    """Return sum_j n_ij w_mj b_mjk', (K, 3, 3, ..., NF, NS or 1)."""
    if isinstance(counts, int):
        return counts * np.einsum('a...ms,kc...ms->kac...m', w, b)[..., None]
    return (w[:, None] * b[:, None]) @ counts


def solve(evaluate: Callable[[Array], tuple[Array, Array]], start: Array, largest: Array,
          steps: int) -> Array:
    """Return where a value vanishes, by steps ``x - matrix^-1 value``.

    Parameters
    ----------
    evaluate : callable
        Value (..., K) and matrix (..., K, K) at x (..., K).
    start : (..., K) array
        Where to begin.
    largest : (K,) array
        Largest step of each unknown; a longer step is shortened as a whole.
    steps : int
        Steps at most; it ends when all are below CONVERGED of the largest.
    """
    x = start
    for _ in range(steps):
        value, matrix = evaluate(x)
        scaled = matrix * largest[:, None] * largest
        step = np.linalg.solve(scaled, (value * largest)[..., None])[..., 0]
        size = np.abs(step).max(axis=-1, keepdims=True)
        x = x - largest * step / np.maximum(size, 1.0)
        if size.max(initial=0.0) < CONVERGED:
            break
    return x
