# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The maps of how well the projection is known, and of how much it has changed."""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.units import ARCSEC
from starcal_ros.report.chart import Chart
from starcal_ros.report.detector_charts import colour_map, places, shift_map
from starcal_ros.results import projection
from starcal_ros.results.comparison import turned_best

_CELLS = 48             # of a map along each side of the detector


def camera_sigmas(detector: Detector, values: Array, covariance: Array, lens: LensModel,
                  f_px: float) -> tuple[Chart, Chart]:
    """Return the maps of the sigma of a place by the camera alone, each axis, and as an angle.

    The angle is by the scale in the middle, of a focal length f_px [px].
    """
    place, uv = _grid(detector)
    sigma = projection.sigma_px(uv, values, covariance, lens)
    least, most = np.nanmin(sigma), np.nanmax(sigma)
    scale = 1.0 / f_px / ARCSEC
    return (colour_map(f'Place of a direction: 1 sigma, {least:.2g} to {most:.2g} px', place,
                       sigma, detector, 'px'),
            colour_map('The same as an angle: 1 sigma, '
                       f'{scale * least:.2g} to {scale * most:.2g}″', place, scale * sigma,
                       detector, '″'))


def direction_sigma(detector: Detector, intrinsics: Array, covariance: Array) -> Chart:
    """Return the map of the sigma of a pixel's direction in the gyro axes, (10, 10) covariance."""
    place, uv = _grid(detector)
    sigma = projection.sigma_direction(uv, intrinsics, covariance, detector.pitch_mm) / ARCSEC
    return colour_map(
        f'Direction of a pixel in the gyro axes: 1 sigma, {sigma.min():.2g} to {sigma.max():.2g}″',
        place, sigma, detector, '″')


def change_map(title: str, detector: Detector, before: Array, after: Array) -> Chart:
    """Return the map of how the place of a direction changed from a camera to another."""
    def field(cells: int) -> tuple[Array, Array]:
        place, uv = _grid(detector, cells)
        return place, turned_best(uv, before, after, detector.pitch_mm)[1]

    return shift_map(title, field, detector)


def _grid(detector: Detector, cells: int = _CELLS) -> tuple[Array, Array]:
    place = places(detector, cells)
    return place, np.asarray(place - detector.centre_raster)
