# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A lens before pixels that displace centroids by where in them a star falls.

Eq. (P.1) of `core.pixel_phase` after any lens: four values [px] follow those of the lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from starcal_ros.core import pixel_phase
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.model import LensModel

SIGMA_PX = 0.1
"""What is expected of an amplitude before any star is seen."""

_COUNT = len(pixel_phase.NAMES)
_LAST = 99              # of the powers: after all of the lens
_STEPS = 40             # of the undisplaced place; each leaves a part 2 pi amplitude of the error


@dataclass(frozen=True)
class PhasedLens:
    """A lens and its pixels.

    Attributes
    ----------
    optics : LensModel
        The lens.
    detector : Detector
        Its pixels.
    """

    optics: LensModel
    detector: Detector

    @property
    def name(self) -> str:
        """That of the lens."""
        return self.optics.name

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its values."""
        return (*self.optics.parameters, *pixel_phase.NAMES)

    @property
    def powers(self) -> tuple[int, ...]:
        """As of the lens; the phase comes last."""
        return (*self.optics.powers, *(_LAST,) * _COUNT)

    @property
    def scale(self) -> Array:
        """What arithmetic divides the values by, (p,)."""
        return np.append(self.optics.scale, np.full(_COUNT, SIGMA_PX))

    def project(self, r_s: Array, values: Array) -> Array:
        """Return the centroids (..., n, 2) [px] of directions (..., n, 3)."""
        uv = self.optics.project(r_s, values[..., :-_COUNT])
        return uv + self._displaced(uv, values)

    def unproject(self, uv: Array, values: Array) -> Array:
        """Return the unit directions (..., n, 3) of centroids (..., n, 2) [px]."""
        place = uv
        for _ in range(_STEPS):
            place = uv - self._displaced(place, values)
        return self.optics.unproject(place, values[..., :-_COUNT])

    def linearize(self, r_s: Array, values: Array) -> tuple[Array, Array, Array]:
        """Return centroids and their derivatives by rotation and values."""
        uv, H_rotation, H_values = self.optics.linearize(r_s, values[..., :-_COUNT])
        waves = self._waves(uv)
        s_u, c_u, s_v, c_v = np.moveaxis(values[..., None, -_COUNT:], -1, 0)
        # d (a sin + b cos) = 2 pi (a cos - b sin) du
        slope = 1.0 + 2.0 * np.pi * np.stack((
            s_u * waves[..., 0, 1] - c_u * waves[..., 0, 0],
            s_v * waves[..., 1, 3] - c_v * waves[..., 1, 2]), axis=-1)[..., None]
        return (uv + self._displaced(uv, values), slope * H_rotation,
                np.concatenate((slope * H_values, waves), axis=-1))

    def ahead(self, r_s: Array) -> Mask:
        """Tell which unit directions the lens is made for."""
        return self.optics.ahead(r_s)

    def _waves(self, uv: Array) -> Array:
        return pixel_phase.waves(uv + self.detector.centre_raster)

    def _displaced(self, uv: Array, values: Array) -> Array:
        return np.asarray((self._waves(uv) @ values[..., None, -_COUNT:, None])[..., 0])
