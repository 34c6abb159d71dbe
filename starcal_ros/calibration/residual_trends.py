# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How residuals depend on what a camera model does not know: pixel, brightness and colour.

Stars are parted by each into `PARTS` of like number; of pixels, into as many of like width.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from starcal_ros.calibration.fitted_stars import FittedStars
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.camera import Detector
from starcal_ros.sky import catalog

PARTS = 10
_LEAST = 5              # stars of a part

PIXEL_U, PIXEL_V, MAGNITUDE, COLOUR = 'pixel_u', 'pixel_v', 'magnitude', 'b_v'


def trends(uv_raster: Array, residual: Array, magnitude: Array, colour: Array
           ) -> dict[str, list[dict[str, Any]]]:
    """Return mean and RMS of residuals, part by part, for JSON.

    Parameters
    ----------
    uv_raster : (n, 2) array
        Predicted centroids, whose place in a pixel is -0.5 to 0.5 from its centre [px].
    residual : (n, 2) array
        Measured minus predicted [px].
    magnitude, colour : (n,) array
        Hp and B-V [mag], NaN where not known; such stars are in no part.
    """
    phase = uv_raster - np.round(uv_raster)
    of_pixel = np.minimum(((phase + 0.5) * PARTS).astype(np.int64), PARTS - 1)
    found = {PIXEL_U: _parts(phase[:, 0], residual, of_pixel[:, 0]),
             PIXEL_V: _parts(phase[:, 1], residual, of_pixel[:, 1])}
    for name, values in ((MAGNITUDE, magnitude), (COLOUR, colour)):
        known = np.isfinite(values)
        found[name] = _parts(values[known], residual[known], _quantiles(values[known]))
    return found


def of_stars(stars: FittedStars, catalog_id: Ints, detector: Detector
             ) -> dict[str, list[dict[str, Any]]]:
    """Return the trends of stars that were fitted; their brightness is that of the catalogue.

    Parameters
    ----------
    stars : FittedStars
    catalog_id : (n,) int64 array
        Their numbers.
    detector : Detector
    """
    known = catalog.load_containing(catalog_id)
    return trends(stars.uv + detector.centre_raster, stars.z * stars.sigma[:, None],
                  stars.magnitude, known.colour[known.rows(catalog_id)])


def _quantiles(values: Array) -> Ints:
    if not len(values):
        return np.empty(0, np.int64)
    edges = np.quantile(values, np.linspace(0.0, 1.0, PARTS + 1)[1:-1])
    return np.asarray(np.searchsorted(edges, values), np.int64)


def _parts(values: Array, residual: Array, part: Ints) -> list[dict[str, Any]]:
    """Return the parts that have stars enough."""
    found = []
    for k in range(PARTS):
        mine = part == k
        stars = int(mine.sum())
        if stars < _LEAST:
            continue
        mean, rms = residual[mine].mean(axis=0), np.sqrt(np.mean(residual[mine]**2, axis=0))
        sigma = residual[mine].std(axis=0, ddof=1) / np.sqrt(stars)
        found.append({'at': float(values[mine].mean()), 'stars': stars,
                      'mean_px': mean.tolist(), 'sigma_of_mean_px': sigma.tolist(),
                      'rms_px': rms.tolist()})
    return found
