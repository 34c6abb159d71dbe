# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Residuals in the plane of which some are wrong: their scale, and weights that resist these.

The length of a residual with normal components of sigma s has the median ``s sqrt(2 ln 2)``
(Rayleigh), which half of the residuals may be wrong without spoiling. Geman and McClure's weight
(Bulletin of the International Statistical Institute 52-4, 1987) ::

    w(x) = 1 / (1 + x^2)^2,    x = length / (width s)                                  (R.1)

ends the influence of a residual that is much longer than most.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array

RAYLEIGH_MEDIAN = float(np.sqrt(2.0 * np.log(2.0)))


def scale_of(length: Array) -> float:
    """Return s, of each component, from lengths (n,) of residuals of which few are wrong."""
    return float(np.median(length)) / RAYLEIGH_MEDIAN


def sigma_factor(length: Array, scale: Array | float, width: float) -> Array:
    """Return by what a sigma grows for the weight of Eq. (R.1): the root of 1 / w, (n,)."""
    return 1.0 + (length / (width * scale))**2
