# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is known of a fisheye before any star in its images has a name.

Patterns know pinholes only, and no pinhole sees all that a fisheye does. The middle of its field,
as an equidistant lens of about the focal length has it, is therefore shown to them as a pinhole
would have it: always the same field of 80 deg. What the lens is beyond the middle, its own stars
tell, from the middle outwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.fisheye import KannalaBrandtLens
from starcal_ros.identification.camera_guess import OFF_CENTRE, CameraGuess

_MIDDLE = np.radians(40.0)      # from the axis, where patterns are looked for


@dataclass(frozen=True)
class FisheyeGuess(CameraGuess):
    """A fisheye of four coefficients (Kannala and Brandt) and how wrong it may be.

    The detector has a pitch of 1 mm: all mm are pixels.
    """

    @classmethod
    def of_focal_length(cls, detector: Detector, focal_length_mm: float, error: float
                        ) -> FisheyeGuess:
        """Return an uncalibrated fisheye whose focal length is known to a part `error` of itself.

        The sigmas: half the error of the focal length, 3 % of the width for the principal point.
        """
        found = cls(detector, np.array([0.0, 0.0, focal_length_mm, *(0.0,) * 4]), np.eye(7))
        off_centre = OFF_CENTRE * detector.width
        sigma = np.array([off_centre, off_centre, 0.5 * error * focal_length_mm,
                          *found.lens.sigma])
        return cls(detector, found.intrinsics, np.diag(sigma**2))

    @property
    def lens(self) -> KannalaBrandtLens:
        """Model of the lens."""
        corner = 0.5 * float(np.hypot(self.detector.width, self.detector.height))
        return KannalaBrandtLens(corner / self.intrinsics[2])

    @property
    def seen(self) -> Detector:
        """Detector of a pinhole on which patterns are looked for."""
        width = round(2.0 * self.intrinsics[2] * float(np.tan(_MIDDLE)))
        return Detector(width, width, self.detector.pitch_mm)

    def flattened(self, uv: Array) -> tuple[Ints, Array]:
        """Return which spots (n, 2) fall on `seen`, and where (m, 2), from its centre [px]."""
        off_axis = np.linalg.norm(uv, axis=-1) / self.intrinsics[2]
        middle = np.flatnonzero(off_axis < _MIDDLE)
        theta = off_axis[middle, None]
        return middle, uv[middle] * np.sinc(theta / np.pi) / np.cos(theta)
