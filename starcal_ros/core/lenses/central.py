# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What all lens models in pixels share: the detector behind an image of unit focal length.

In axes o of OpenCV (x right, y down, z out of the lens; ``r_o = diag(-1, -1, 1) r_s``) a lens
makes of a direction an image point m, and the detector of it a centroid ::

    uv = (u0, v0) + f m(r_o, c)                                                        (L.1)

with u0, v0, f in pixels and coefficients c without unit. A rotation Psi moves r by Psi x r, so
with D = dm/dr, row by row, ``dm/dPsi = r x D``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from starcal_ros.core.arrays import Array, Mask

_OPTICAL = np.array([-1.0, -1.0, 1.0])
_SCALE_PX = 100.0       # of u0, v0 and f
_SIGMA = 0.3            # what a coefficient may move a star in the corner, over its distance


@dataclass(frozen=True)
class CentralLens(ABC):
    """A lens through whose image point at unit focal length all else is told.

    Attributes
    ----------
    reach : float
        Distance of the corner of the detector from its centre, in focal lengths: it gives the
        coefficients their scale and takes no part in the projection.
    """

    reach: float
    name: ClassVar[str]
    coefficients: ClassVar[tuple[str, ...]]
    orders: ClassVar[tuple[int, ...]]
    """The powers of the coefficients."""
    held: ClassVar[tuple[str, ...]] = ()
    """Parameters that only the coefficients' choice of origin would tell."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its values."""
        return ('u0', 'v0', 'f', *self.coefficients)

    @property
    def powers(self) -> tuple[int, ...]:
        """Power of the distance from the axis that each value acts by, over the place itself."""
        return (0, 0, 0, *self.orders)

    @property
    def scale(self) -> Array:
        """What arithmetic divides the values by, (p,).

        It is what is expected of them: those that stars tell nothing of meet ones then.
        """
        return np.array([*(_SCALE_PX,) * 3, *self.sigma])

    @property
    def sigma(self) -> Array:
        """What is expected of the coefficients before any star is seen, (q,)."""
        return _SIGMA * self.reach ** -np.array(self.orders, float)

    @abstractmethod
    def image(self, r_o: Array, c: Array) -> tuple[Array, Array, Array]:
        """Return image points and their derivatives.

        Parameters
        ----------
        r_o : (..., n, 3) array
            Directions, of any length.
        c : (q, ..., 1) array
            Coefficients.

        Returns
        -------
        m : (..., n, 2) array
        by_direction : (..., n, 2, 3) array
        by_coefficient : (..., n, 2, q) array
        """

    @abstractmethod
    def ray(self, m: Array, c: Array) -> Array:
        """Return the unit directions (..., n, 3), in o, of image points (..., n, 2)."""

    @abstractmethod
    def ahead(self, r_s: Array) -> Mask:
        """Tell which unit directions (..., 3) the model is made for, whatever its values."""

    def project(self, r_s: Array, values: Array) -> Array:
        """Return the centroids (..., n, 2) [px] of directions r_s (..., n, 3)."""
        m, *_ = self.image(r_s * _OPTICAL, _coefficients(values))
        return values[..., None, :2] + values[..., None, 2:3] * m

    def unproject(self, uv: Array, values: Array) -> Array:
        """Return the unit directions r_s (..., n, 3) of centroids uv (..., n, 2) [px]."""
        m = (uv - values[..., None, :2]) / values[..., None, 2:3]
        return self.ray(m, _coefficients(values)) * _OPTICAL

    def linearize(self, r_s: Array, values: Array) -> tuple[Array, Array, Array]:
        """Return centroids (..., n, 2) and their derivatives by rotation and values."""
        m, by_direction, by_coefficient = self.image(r_s * _OPTICAL, _coefficients(values))
        f = values[..., None, 2:3]
        H_values = np.empty((*m.shape, len(self.parameters)))
        H_values[..., :2] = np.eye(2)
        H_values[..., 2] = m
        np.multiply(f[..., None], by_coefficient, out=H_values[..., 3:])
        H_rotation = np.empty((*m.shape, 3))
        x, y, z = np.moveaxis(r_s[..., None, :], -1, 0)
        a, b, c = np.moveaxis(by_direction, -1, 0)      # r x (-a, -b, c); np.cross takes long
        H_rotation[..., 0] = f * (y * c + z * b)
        H_rotation[..., 1] = -f * (z * a + x * c)
        H_rotation[..., 2] = f * (y * a - x * b)
        return values[..., None, :2] + f * m, H_rotation, H_values


def _coefficients(values: Array) -> Array:
    return np.moveaxis(values[..., 3:], -1, 0)[..., None]
