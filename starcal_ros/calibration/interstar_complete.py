# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Normal equations of the interstar angles where every frame shows every star (S24).

What `interstar_equations` sums over the stars of a frame is then a sum of products of 3x3
matrices. With W the directions of a frame (NS, 3), B_k the instruments, M_l what moves the
directions, ``Q_k = B_k W'`` and ``N_l = M_l W'``, the pairs of the frame give ::

    sum_{i<j} (Q_k + Q_k')_ij (N_l + N_l')_ij = <B_k'M_l, W'W> + <B_k'W, (M_l'W)'>            (G.1)

with the spots' products with themselves still to be taken off: the scalar products of the rows of
[W B] and [W M] say all of a frame, and the mean over the frames is one matrix product.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.calibration.interstar_equations import SpotDirections, joined, pinhole
from starcal_ros.core.arrays import Array


def pinhole_equations(uv: Array, x: Array, pitch_mm: float, cosines: Array | None,
                      constrained: bool, newton: bool) -> tuple[Array, Array]:
    """Return A'e and its derivative for pinhole cameras, one a round.

    Parameters
    ----------
    uv : (rounds, NF, NS, 2) array
        Spots, from where the intrinsics count [px].
    x : (rounds, 3) array
        u0, v0 [px] and f [mm].
    pitch_mm : float
        Pixel pitch [mm].
    cosines : (rounds, NS, NS) array or None
        v_i . v_j of the catalogue; None compares the frames with one another.
    constrained : bool
        Hold r, Eq. (I.2), WC.
    newton : bool
        By the derivative of e; otherwise the matrix is A'A.

    Returns
    -------
    value, matrix : (rounds, 3), (rounds, 3, 3) array
        As of `normal_equations`.
    """
    sight = pinhole(uv, x, pitch_mm, constrained)
    return normal_equations(sight, sight.by_intrinsics if newton else sight.instruments, cosines)


def normal_equations(sight: SpotDirections, moved: Array, cosines: Array | None = None
                     ) -> tuple[Array, Array]:
    """Return A'e and its derivative: as `interstar_equations.equations` and their `product`.

    Parameters
    ----------
    sight : SpotDirections
        Of complete frames.
    moved : (L, 3, ..., NF, NS) array
        By what the directions move: the instruments give A'A.
    cosines : (..., NS, NS) array, optional
        v_i . v_j of the catalogue; without it the frames are compared with one another.

    Returns
    -------
    value : (..., K) array
        A'e.
    matrix : (..., K, L) array
        Its derivative, at vanishing e.
    """
    w, b = sight.w, sight.instruments
    left = _rows(w, b)
    right = left if moved is b else _rows(w, moved)
    # Frames innermost, so that the sums below run over what lies side by side.
    grams = np.ascontiguousarray(np.moveaxis(
        left @ np.ascontiguousarray(np.swapaxes(right, -1, -2)), -3, -1))
    grams = grams.reshape(*w.shape[1:-2], 1 + len(b), 3, 1 + len(moved), 3, -1)
    matrix = (np.einsum('...kalcm,...acm->...kl', grams[..., 1:, :, 1:, :, :],
                        grams[..., 0, :, 0, :, :])
              + np.einsum('...kacm,...alcm->...kl', grams[..., 1:, :, 0, :, :],
                          grams[..., 0, :, 1:, :, :]))
    # A spot makes no pair with itself.
    own = np.einsum('ka...ms,a...ms->k...ms', b, w)
    own_moved = own if moved is b else np.einsum('la...ms,a...ms->l...ms', moved, w)
    if cosines is None:
        crossed = _over_frames(b, w)
        crossed_moved = crossed if moved is b else _over_frames(moved, w)
        matrix = w.shape[-2] * matrix - np.einsum(
            'k...ij,l...ij->...kl', crossed + np.swapaxes(crossed, -1, -2), crossed_moved)
        own = w.shape[-2] * own - own.sum(axis=-2, keepdims=True)
    matrix -= 2.0 * np.einsum('k...ms,l...ms->...kl', own, own_moved)
    return np.einsum('ka...ms,a...ms->...k', b, joined(w, cosines, None)[2]), matrix


def _rows(w: Array, more: Array) -> Array:
    """Return the components of w and of more (K, 3, ...) as rows (..., NF, 3 + 3 K, NS)."""
    out = np.empty((*w.shape[1:-1], 3 + 3 * len(more), w.shape[-1]))
    out[..., :3, :] = np.moveaxis(w, 0, -2)
    out[..., 3:, :] = np.moveaxis(more.reshape(-1, *w.shape[1:]), 0, -2)
    return out


def _over_frames(b: Array, w: Array) -> Array:
    """Return sum_m b_mik . w_mj, (K, ..., NS, NS)."""
    return np.asarray(np.sum(np.swapaxes(b, -1, -2) @ w, axis=1))
