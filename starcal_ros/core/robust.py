# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of which some are wrong: their middle, and the scale and the weights of residuals.

The length of a residual in the plane with normal components of sigma s has the median
``s sqrt(2 ln 2)`` (Rayleigh), which half of the residuals may be wrong without spoiling. Geman and
McClure's weight (Bulletin of the International Statistical Institute 52-4, 1987) ::

    w(x) = 1 / (1 + x^2)^2,    x = length / (width s)                                  (R.1)

ends the influence of a residual that is much longer than most.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array, Ints

RAYLEIGH_MEDIAN = float(np.sqrt(2.0 * np.log(2.0)))


def middle(counts: Ints) -> float:
    """Return the median of integers, (n,), of which many may be equal, as the steps of stamps are.

    NaN of none. By sorting: numpy's selection among equal integers takes thirty times as long.
    """
    ordered, n = np.sort(counts), len(counts)
    if not n:
        return float(np.nan)
    return 0.5 * float(ordered[(n - 1) // 2] + ordered[n // 2])


def scale_of(length: Array) -> float:
    """Return s, of each component, from lengths (n,) of residuals of which few are wrong."""
    return float(np.median(length)) / RAYLEIGH_MEDIAN


def sigma_factor(length: Array, scale: Array | float, width: float) -> Array:
    """Return by what a sigma grows for the weight of Eq. (R.1): the root of 1 / w, (n,)."""
    return 1.0 + (length / (width * scale))**2
