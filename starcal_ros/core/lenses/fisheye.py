# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fisheye lenses: the distance from the axis grows with the angle, not with its tangent.

With theta the angle of a direction from the axis, 0 to 180 deg, and e its direction about it ::

    m = e theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)               (L.3)

(Kannala and Brandt, IEEE PAMI 28-8, 2006, with f for their k1; OpenCV's ``fisheye``, ROS's
``equidistant``). Without coefficients it is the equidistant lens. Nothing is divided by Z: an
angle of 90 deg or more is like any other.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.lenses.central import CentralLens

_LEAST_Z = -0.98        # 168 deg off the axis: the point behind has no direction about it
_STEPS, _LAST_STEP = 30, 1e-14
_TINY = 1e-9            # of Z: nearer to the axis theta is the tangent


class EquidistantLens(CentralLens):
    """A fisheye without coefficients."""

    name = 'equidistant'
    coefficients: ClassVar[tuple[str, ...]] = ()
    orders: ClassVar[tuple[int, ...]] = ()

    def image(self, r_o: Array, c: Array) -> tuple[Array, Array, Array]:
        """Return image points and their derivatives, as of `CentralLens`."""
        xy, z = r_o[..., :2], r_o[..., 2]
        rho = np.hypot(xy[..., 0], xy[..., 1])
        theta = np.arctan2(rho, z)
        distance, slope, powers = _distance(theta, c)
        near = rho <= _TINY * np.abs(z)
        safe = np.where(near, 1.0, rho)
        e = np.where(near[..., None], 0.0, xy / safe[..., None])
        across = np.where(near, 1.0 / np.where(near, z, 1.0), distance / safe)
        # d theta = (z e, -rho) / |r|^2 dr, and e turns by 1 / rho.
        squares = rho * rho + z * z
        by_direction = np.empty((*rho.shape, 2, 3))
        along = slope * z / squares - across
        by_direction[..., :2] = (e[..., :, None] * e[..., None, :] * along[..., None, None]
                                 + np.eye(2) * across[..., None, None])
        by_direction[..., 2] = -e * (slope * rho / squares)[..., None]
        return xy * across[..., None], by_direction, e[..., :, None] * powers[..., None, :]

    def ray(self, m: Array, c: Array) -> Array:
        """Return the unit directions of image points, by Newton's method on the angle."""
        wanted = np.hypot(m[..., 0], m[..., 1])
        theta = np.minimum(wanted, np.pi)
        for _ in range(_STEPS if len(c) else 0):
            distance, slope, _ = _distance(theta, c)
            step = (distance - wanted) / np.where(np.abs(slope) > 0.05, slope, 0.05)
            theta = np.clip(theta - step, 0.0, np.pi)
            if np.abs(step).max(initial=0.0) < _LAST_STEP:
                break
        e = m / np.where(wanted > 0.0, wanted, 1.0)[..., None]
        return np.concatenate((e * np.sin(theta)[..., None], np.cos(theta)[..., None]), axis=-1)

    def ahead(self, r_s: Array) -> Mask:
        """Tell which unit directions are not straight behind."""
        return np.asarray(r_s[..., 2] > _LEAST_Z)


class KannalaBrandtLens(EquidistantLens):
    """A fisheye with four coefficients."""

    name = 'kannala_brandt'
    coefficients = ('k1', 'k2', 'k3', 'k4')
    orders = (2, 4, 6, 8)


def _distance(theta: Array, c: Array) -> tuple[Array, Array, Array]:
    """Return the distance from the axis, its slope, and its derivatives (..., n, q) by c."""
    square = theta * theta
    powers = np.empty((*theta.shape, len(c)))
    distance, slope, power = theta.copy(), np.ones_like(theta), theta
    for k in range(len(c)):
        slope = slope + (2 * k + 3) * c[k] * power * theta
        power = power * square
        powers[..., k] = power
        distance = distance + c[k] * power
    return distance, slope, powers
