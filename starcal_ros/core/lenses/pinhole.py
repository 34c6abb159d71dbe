# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Lenses whose ideal is the pinhole: distortion of the point (X/Z, Y/Z)."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.lenses.central import CentralLens

_LEAST_Z = 0.1          # 84 deg off the axis
_STEPS, _LAST_STEP = 20, 1e-13


class PinholeLens(CentralLens):
    """A pinhole behind which the image is distorted."""

    @abstractmethod
    def distorted(self, a: Array, b: Array, c: Array) -> tuple[Array, Array, Array]:
        """Return distorted points (..., 2) of (a, b), (...,), their slopes and by c.

        The slopes by (a, b) are (..., 2, 2), the derivatives by the coefficients (..., 2, q).
        """

    def image(self, r_o: Array, c: Array) -> tuple[Array, Array, Array]:
        """Return image points and their derivatives, as of `CentralLens`."""
        x, y, z = np.moveaxis(r_o, -1, 0)
        a, b = x / z, y / z
        m, slope, by_coefficient = self.distorted(a, b, c)
        # d(a, b) = ((1, 0, -a), (0, 1, -b)) / z dr
        along = -(slope[..., 0] * a[..., None] + slope[..., 1] * b[..., None])
        by_direction = np.concatenate((slope, along[..., None]), axis=-1) / z[..., None, None]
        return m, by_direction, by_coefficient

    def ray(self, m: Array, c: Array) -> Array:
        """Return the unit directions of image points, by Newton's method."""
        ab = m
        for _ in range(_STEPS):
            there, slope, _ = self.distorted(ab[..., 0], ab[..., 1], c)
            step = np.linalg.solve(slope, (there - m)[..., None])[..., 0]
            ab = ab - step
            if np.abs(step).max(initial=0.0) < _LAST_STEP:
                break
        r_o = np.concatenate((ab, np.ones((*ab.shape[:-1], 1))), axis=-1)
        unit: Array = r_o / np.linalg.norm(r_o, axis=-1, keepdims=True)
        return unit

    def ahead(self, r_s: Array) -> Mask:
        """Tell which unit directions a pinhole can see."""
        return np.asarray(r_s[..., 2] > _LEAST_Z)
