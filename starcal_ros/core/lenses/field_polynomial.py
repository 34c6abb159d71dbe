# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A polynomial of the field: what has no shape that anybody has given a name.

With a = X/Z and b = Y/Z ::

    m_x = (1 + a10) a + a01 b + sum of a_ij a^i b^j
    m_y = b + sum of b_ij a^i b^j,      i + j = 2 to 5                                (L.4)

It is what SIP is to a world coordinate system (Shupe et al., ADASS XIV, 2005), but from the sky to
the image. The attitude takes what is left of the first order, and f its size. A tilt of the camera
moves all stars, to first order, by a constant and terms of the second order, which are all free:
the principal point is a matter of choice, and is held in the centre of the detector.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.core.lenses.pinhole import PinholeLens

_ORDER = 5
_TERMS = tuple((i, n - i) for n in range(2, _ORDER + 1) for i in range(n, -1, -1))
_N = len(_TERMS)
_I, _J = (np.array(each) for each in zip(*_TERMS))


class FieldPolynomialLens(PinholeLens):
    """A polynomial of the fifth order for each axis."""

    name = 'polynomial'
    coefficients = ('a10', 'a01', *(f'{axis}{i}{j}' for axis in 'ab' for i, j in _TERMS))
    orders = (0, 0, *(i + j - 1 for i, j in _TERMS), *(i + j - 1 for i, j in _TERMS))
    held = ('u0', 'v0')

    def distorted(self, a: Array, b: Array, c: Array) -> tuple[Array, Array, Array]:
        """Return distorted points, their slopes, and the derivatives by the coefficients."""
        c = np.moveaxis(c, 0, -1)
        x, y = _powers(a), _powers(b)
        terms = x[..., _I] * y[..., _J]
        by_a = _I * x[..., np.maximum(_I - 1, 0)] * y[..., _J]
        by_b = _J * x[..., _I] * y[..., np.maximum(_J - 1, 0)]
        of_x, of_y = c[..., 2:2 + _N], c[..., 2 + _N:]
        m = np.stack((a + c[..., 0] * a + c[..., 1] * b + np.sum(of_x * terms, axis=-1),
                      b + np.sum(of_y * terms, axis=-1)), axis=-1)
        slope = np.stack((
            np.stack((1.0 + c[..., 0] + np.sum(of_x * by_a, axis=-1),
                      c[..., 1] + np.sum(of_x * by_b, axis=-1)), axis=-1),
            np.stack((np.sum(of_y * by_a, axis=-1),
                      1.0 + np.sum(of_y * by_b, axis=-1)), axis=-1)), axis=-2)
        by = np.zeros((*m.shape, len(self.coefficients)))
        by[..., 0, 0], by[..., 0, 1] = a, b
        by[..., 0, 2:2 + _N] = by[..., 1, 2 + _N:] = terms
        return m, slope, by


def _powers(a: Array) -> Array:
    """Return the powers of a, from 0 to _ORDER, (..., _ORDER + 1)."""
    return np.asarray(np.cumprod(np.stack((np.ones_like(a), *(a,) * _ORDER), axis=-1), axis=-1))
