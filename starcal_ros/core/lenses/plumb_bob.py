# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The camera of T18 (`starcal_ros.core.camera`) as one lens model among others.

Its seven values are in the units of T18, f in mm and the distortion in powers of mm, so that it
needs the pixel pitch. Up to those units it is ``plumb_bob`` of ROS.
"""

from __future__ import annotations

from dataclasses import dataclass

from starcal_ros.core import camera
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.camera import INTRINSICS, INTRINSICS_SCALE

_LEAST_Z = 0.1          # 84 deg off the axis


@dataclass(frozen=True)
class Tan2018Lens:
    """The five-term lens.

    Attributes
    ----------
    pitch_mm : float
        Pixel pitch [mm].
    """

    pitch_mm: float
    name = 'plumb_bob'
    parameters = INTRINSICS
    powers = (0, 0, 0, 2, 4, 1, 1)
    scale = INTRINSICS_SCALE

    def project(self, r_s: Array, values: Array) -> Array:
        """Return the centroids (..., n, 2) [px] of directions (..., n, 3)."""
        return camera.project(r_s, values, self.pitch_mm)

    def unproject(self, uv: Array, values: Array) -> Array:
        """Return the unit directions (..., n, 3) of centroids (..., n, 2) [px]."""
        return camera.unproject(uv, values, self.pitch_mm)

    def linearize(self, r_s: Array, values: Array) -> tuple[Array, Array, Array]:
        """Return centroids and their derivatives by rotation and values."""
        return camera.linearize(r_s, values, self.pitch_mm)

    def ahead(self, r_s: Array) -> Mask:
        """Tell which unit directions a pinhole can see."""
        return r_s[..., 2] > _LEAST_Z
