# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The spot of a star: a Gaussian, drawn along a trail while the exposure lasts, seen by pixels.

Model
-----
The part of a star's light in pixel (i, j), whose centre is (i, j) ::

    m_ij = integral over t of p(i - u(t)) p(j - v(t)),   t = -1/2 .. 1/2 of the exposure   (P.1)
    p(x) = Phi((x + 1/2) / s) - Phi((x - 1/2) / s)                                         (P.2)

    s        px    standard deviation of the spot of a star at rest
    Phi            normal distribution

A spot at rest needs no integral. The integral is Gauss and Legendre's sum, a point and a bit to a
sigma of the trail: good to 1e-5 of the brightest pixel.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.core.distributions import normal_cdf


def profile(edges: Array, sigma: Array | float) -> Array:
    """Return p, Eq. (P.2), of neighbouring pixels.

    Parameters
    ----------
    edges : (..., k + 1) array
        Distances of their edges from the spot, in order [px].
    sigma : float or (..., 1) array
        Of the spot [px].

    Returns
    -------
    p : (..., k) array
    """
    return np.diff(normal_cdf(edges / sigma))


def profile_slopes(edges: Array, sigma: Array | float) -> tuple[Array, Array]:
    """Return the first and the second derivative of `profile` by the place of the spot."""
    z = edges / sigma
    density = np.exp(-0.5 * z * z) / (np.sqrt(2.0 * np.pi) * sigma)
    return -np.diff(density), -np.diff(z * density) / sigma


@cache
def points(count: int) -> tuple[Array, Array]:
    """Return t (count,) in -1/2 .. 1/2 and the weights (count,) of the integral of Eq. (P.1)."""
    t, weight = np.polynomial.legendre.leggauss(count)
    return t / 2.0, weight / 2.0


def count(length_px: float, sigma: float) -> int:
    """Return how many points a trail needs."""
    return 1 if length_px == 0.0 else 3 + int(np.ceil(1.15 * length_px / sigma))
