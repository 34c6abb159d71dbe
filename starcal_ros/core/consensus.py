# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The attitude that most stars of a frame agree with."""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask

OUT_OF_PLACE = 0.1
"""Of the size of a frame: no camera that is calibrated puts a star so far off."""
_PAIRS = 500            # pairs that are tried, at most
_JUDGES = 1000          # stars that choose among them, at most


def consensus(u_i: Array, r_s: Array, tolerance: float) -> Mask:
    """Tell which stars agree with the attitude that most of them agree with.

    Parameters
    ----------
    u_i, r_s : (n, 3) array
        Unit vectors to the stars: catalogue, in i, and measured, in s.
    tolerance : float
        Angle allowed between the measured and the predicted direction of a star [rad].

    Returns
    -------
    agreeing : (n,) bool array
    """
    first, second = _pairs(len(u_i))
    if not len(first):
        return np.zeros(len(u_i), dtype=bool)
    C_si = _triad(r_s[first], r_s[second]) @ np.swapaxes(_triad(u_i[first], u_i[second]), -1, -2)
    judges = slice(None, None, (len(u_i) - 1) // _JUDGES + 1)
    miss = _miss(C_si, u_i[judges], r_s[judges])
    found = miss <= tolerance
    # Most stars first; among equals the smallest misses.
    merit = found.sum(axis=1) - np.where(found, miss, 0.0).mean(axis=1) / (2.0 * tolerance)
    return np.asarray(_miss(C_si[np.argmax(merit)], u_i, r_s) <= tolerance)


def _pairs(n: int) -> tuple[Ints, Ints]:
    """Return pairs of n stars, at most _PAIRS: evenly from the row by row list of all."""
    count = n * (n - 1) // 2
    place = np.arange(0, count, count // _PAIRS + 1)
    begins = np.concatenate(([0], np.cumsum(np.arange(n - 1, 0, -1))))  # of each star's row
    first = np.searchsorted(begins, place, side='right') - 1
    return first, place - begins[first] + first + 1


def _miss(C_si: Array, u_i: Array, r_s: Array) -> Array:
    return np.linalg.norm(u_i @ np.swapaxes(C_si, -1, -2) - r_s, axis=-1)


def _triad(a: Array, b: Array) -> Array:
    """Return axes along a, across a and b, and square to both, as columns (..., 3, 3)."""
    across = np.cross(a, b)
    # Stars that coincide give no axes, and no star will agree with them.
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    return np.stack((a, across, np.cross(a, across)), axis=-1)
