# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""OpenCV's rational lens, and the same with a thin prism.

With a = X/Z, b = Y/Z, q = a^2 + b^2 (OpenCV, *Camera Calibration and 3D Reconstruction*) ::

    R = (1 + k1 q + k2 q^2 + k3 q^3) / (1 + k4 q + k5 q^2 + k6 q^3)
    m_x = a R + 2 p1 a b + p2 (q + 2 a^2) + s1 q + s2 q^2                              (L.2)
    m_y = b R + p1 (q + 2 b^2) + 2 p2 a b + s3 q + s4 q^2

The coefficients are in OpenCV's order; the first eight are ``rational_polynomial`` of ROS.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.core.lenses.pinhole import PinholeLens

_RATIONAL = ('k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'k5', 'k6')
_PRISM = ('s1', 's2', 's3', 's4')


class RationalLens(PinholeLens):
    """Eight coefficients."""

    name = 'rational'
    coefficients: ClassVar[tuple[str, ...]] = _RATIONAL
    orders: ClassVar[tuple[int, ...]] = (2, 4, 1, 1, 6, 2, 4, 6)

    def distorted(self, a: Array, b: Array, c: Array) -> tuple[Array, Array, Array]:
        """Return distorted points, their slopes, and the derivatives by the coefficients."""
        k1, k2, p1, p2, k3, k4, k5, k6 = c[:8]
        q = a * a + b * b
        below = 1.0 + q * (k4 + q * (k5 + q * k6))
        R = (1.0 + q * (k1 + q * (k2 + q * k3))) / below
        bend = 2.0 * (k1 + q * (2.0 * k2 + 3.0 * q * k3)
                      - R * (k4 + q * (2.0 * k5 + 3.0 * q * k6))) / below      # 2 dR/dq
        ab = a * b
        m = np.stack((a * R + 2.0 * p1 * ab + p2 * (q + 2.0 * a * a),
                      b * R + p1 * (q + 2.0 * b * b) + 2.0 * p2 * ab), axis=-1)
        slope = np.empty((*m.shape, 2))
        slope[..., 0, 0] = R + a * a * bend + 2.0 * p1 * b + 6.0 * p2 * a
        slope[..., 0, 1] = slope[..., 1, 0] = ab * bend + 2.0 * (p1 * a + p2 * b)
        slope[..., 1, 1] = R + b * b * bend + 6.0 * p1 * b + 2.0 * p2 * a
        by, power = np.empty((*m.shape, 8)), q / below
        for above, under in ((0, 5), (1, 6), (4, 7)):       # k1 and k4, k2 and k5, k3 and k6
            by[..., 0, above], by[..., 1, above] = a * power, b * power
            by[..., under] = -R[..., None] * by[..., above]
            power = power * q
        by[..., 0, 2] = by[..., 1, 3] = 2.0 * ab
        by[..., 1, 2], by[..., 0, 3] = q + 2.0 * b * b, q + 2.0 * a * a
        return m, slope, by


class ThinPrismLens(RationalLens):
    """Twelve coefficients."""

    name = 'thin_prism'
    coefficients = _RATIONAL + _PRISM
    orders = (*RationalLens.orders, 1, 3, 1, 3)

    def distorted(self, a: Array, b: Array, c: Array) -> tuple[Array, Array, Array]:
        """Return distorted points, their slopes, and the derivatives by the coefficients."""
        m, slope, rational = super().distorted(a, b, c)
        s1, s2, s3, s4 = c[8:]
        q = a * a + b * b
        m += np.stack((q * (s1 + s2 * q), q * (s3 + s4 * q)), axis=-1)
        bend = np.stack((s1 + 2.0 * s2 * q, s3 + 2.0 * s4 * q), axis=-1)
        slope += 2.0 * bend[..., :, None] * np.stack((a, b), axis=-1)[..., None, :]
        by = np.zeros((*m.shape, 12))
        by[..., :8] = rational
        by[..., 0, 8] = by[..., 1, 10] = q
        by[..., 0, 9] = by[..., 1, 11] = q * q
        return m, slope, by
