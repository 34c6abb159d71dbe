# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One image as one frame: the spots that may be stars, measured and unidentified."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.models import detector
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.camera import Detector
from starcal_ros.imaging.centroids import EDGE, ELONGATED, of_picture
from starcal_ros.imaging.picture import Picture, Plane
from starcal_ros.imaging.pixels import Scale
from starcal_ros.measurements.samples import Frames

LEFT_OUT = EDGE | ELONGATED
"""Flags of spots that are no measurement of one star's place: cut by the edge of the image, or of
another shape than the stars of the frame (docs/imaging.md has what each flag costs)."""


class SpotMeter:
    """Measures the spots of the images of one camera.

    Parameters
    ----------
    scenario : Scenario
        Camera, exposure, and the group ``image``.
    """

    def __init__(self, scenario: Scenario) -> None:
        image = scenario.image
        self._config = image.centroid
        self._counts = (image.zero_point_electrons_s * scenario.star_tracker.exposure_s
                        / image.gain_electrons)
        self.detector: Detector = detector(scenario.camera)

    def measure(self, image: NDArray[np.generic], stamp_ns: int, pattern: str = ''
                ) -> tuple[Frames, int]:
        """Return the spots of an image, brightest first, and how many more were left out.

        Their magnitude is by the zero point of the scenario, or off by a constant where that is
        not the camera's; nothing needs more than its differences.

        Parameters
        ----------
        image : (height, width) array
            Counts, top row first.
        stamp_ns : int
            Middle of the exposure, UTC since the Unix epoch.
        pattern : str
            Of the colour filters before its pixels, one of `mosaic.PATTERNS`, or empty.

        Raises
        ------
        ValueError
            Where the image is not of the camera's size, or as `Light.of`.
        """
        height, width = self.detector.height, self.detector.width
        if image.shape != (height, width):
            raise ValueError(f'{image.shape[1]} x {image.shape[0]} pixels, the camera has '
                             f'{width} x {height} (camera.width, camera.height)')
        spots = of_picture(Picture.of(Plane(image, Scale.of(image.dtype), None, pattern)),
                           self._config)
        kept = ((spots.flags & LEFT_OUT) == 0) & self.detector.contains(
            spots.uv_raster - self.detector.centre_raster)
        flux = spots.flux[kept]
        bright = flux > 0.0
        magnitude = np.full(len(flux), np.nan)
        if self._counts > 0.0:          # an exposure of 0 s collects nothing
            magnitude[bright] = -2.5 * np.log10(flux[bright] / self._counts)
        return Frames(np.array([stamp_ns]), np.array([0, len(flux)]), spots.uv_raster[kept],
                      spots.sigma[kept], magnitude, np.zeros(len(flux), np.int64)
                      ), int((~kept).sum())
