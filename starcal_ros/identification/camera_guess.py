# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is known of a camera before any star in its images has a name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens

OFF_CENTRE = 0.03
"""Principal point, parts of the width: a lens seldom sits better."""

_RADIAL = 0.01          # what k1 and k2 each move the corner, parts of its distance
_TANGENTIAL = 0.002     # the same of p1 and p2


@dataclass(frozen=True)
class CameraGuess:
    """A camera and how wrong it may be.

    Attributes
    ----------
    detector : Detector
        Its pixels. Where their pitch is unknown, 1 mm does: all mm are then pixels.
    intrinsics : (p,) array
        Values of the lens model, here T18's: as in `starcal_ros.core.camera`.
    covariance : (p, p) array
        Of their errors; zero for one that is known.
    """

    detector: Detector
    intrinsics: Array
    covariance: Array

    @classmethod
    def of_focal_length(cls, detector: Detector, focal_length_mm: float, error: float
                        ) -> CameraGuess:
        """Return an uncalibrated camera whose focal length is known to a part `error` of itself.

        The sigmas: half the error of the focal length, 3 % of the width for the principal point;
        k1 and k2 as if each moved the corner of the detector by 1 % of its distance from the
        centre, p1 and p2 by 0.2 %.

        Raises
        ------
        ValueError
            Where the focal length is not positive or the error not between 0 and 1.
        """
        if not (np.isfinite(focal_length_mm) and focal_length_mm > 0.0):
            raise ValueError(f'focal length {focal_length_mm} mm: a positive number expected')
        if not 0.0 <= error < 1.0:
            raise ValueError(f'error {error} of the focal length: 0 to below 1 expected, '
                             '0.1 is 10 %')
        corner_mm = detector.pitch_mm * np.hypot(detector.width, detector.height) / 2.0
        off_centre = OFF_CENTRE * detector.width
        radial, tangential = _RADIAL / corner_mm**2, _TANGENTIAL / corner_mm
        sigma = np.array([off_centre, off_centre, 0.5 * error * focal_length_mm,
                          radial, radial / corner_mm**2, tangential, tangential])
        return cls(detector, np.array([0.0, 0.0, focal_length_mm, 0.0, 0.0, 0.0, 0.0]),
                   np.diag(sigma**2))

    @classmethod
    def of_field(cls, detector: Detector, low_deg: float, high_deg: float) -> CameraGuess:
        """Return an uncalibrated camera whose field is between two widths [deg].

        Raises
        ------
        ValueError
            Where these are not 0 < low <= high < 140.
        """
        if not 0.0 < low_deg <= high_deg < 140.0:
            raise ValueError(f'field of {low_deg} to {high_deg} deg: '
                             '0 < low <= high < 140 expected')
        width_mm = detector.width * detector.pitch_mm
        short, long = width_mm / (2.0 * np.tan(np.radians([high_deg, low_deg]) / 2.0))
        return cls.of_focal_length(detector, (short + long) / 2.0, (long - short) / (long + short))

    @property
    def lens(self) -> LensModel:
        """Model of the lens."""
        return Tan2018Lens(self.detector.pitch_mm)

    @property
    def seen(self) -> Detector:
        """Detector of a pinhole on which patterns are looked for."""
        return self.detector

    def flattened(self, uv: Array) -> tuple[Ints, Array]:
        """Return which spots (n, 2) fall on `seen`, and where (m, 2), from its centre [px]."""
        return np.arange(len(uv)), uv

    @property
    def focal_range_px(self) -> tuple[float, float]:
        """Two sigma either side of the focal length [px]."""
        f, sigma = self.intrinsics[2], np.sqrt(self.covariance[2, 2])
        scale = 1.0 / self.detector.pitch_mm
        return (max(f - 2.0 * sigma, 0.05 * f) * scale, (f + 2.0 * sigma) * scale)
