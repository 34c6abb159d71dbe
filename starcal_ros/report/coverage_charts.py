# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The charts of what the stars used cover of the detector."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import Detector
from starcal_ros.report.chart import BARS, Chart, chart
from starcal_ros.report.detector_charts import CELLS, cell_of, colour_map, places

_RINGS = 20             # of the chart by radius


def star_counts(uv_raster: Array, detector: Detector) -> tuple[Chart, str]:
    """Return the map of the stars of each cell, and what it says in words."""
    count = np.bincount(cell_of(uv_raster, detector), minlength=CELLS * CELLS).astype(np.float64)
    empty = int(np.count_nonzero(count == 0.0))
    told = (f'{len(uv_raster)} stars, {count.min():.0f} to {count.max():.0f} in each of '
            f'{CELLS} by {CELLS} cells'
            + (f'; {empty} cells have none: there the camera is known by extrapolation alone.'
               if empty else '.'))
    return colour_map('Stars of a cell', places(detector, CELLS), count, detector, 'stars'), told


def radial_counts(uv_raster: Array, detector: Detector) -> Chart:
    """Return the stars over the distance from the centre, by the area that the detector has there.

    Even coverage is level, out into the corners.
    """
    edges = np.linspace(0.0, 0.5 * np.hypot(detector.width, detector.height), _RINGS + 1)
    # The area of a ring that lies on the detector, by a fine grid of it.
    fine = np.linalg.norm(places(detector, 400) - detector.centre_raster, axis=-1)
    area = np.histogram(fine, edges)[0] * (detector.width * detector.height / len(fine))
    stars = np.histogram(np.linalg.norm(uv_raster - detector.centre_raster, axis=-1), edges)[0]
    kept = area > 0.0
    return chart(
        'Stars an area of 100 × 100 px over the distance from the centre',
        [go.Bar(x=0.5 * (edges[1:] + edges[:-1])[kept], y=(1e4 * stars / np.where(
            kept, area, 1.0))[kept], marker={'color': BARS},
            hovertemplate='%{x:.0f} px: %{y:.3g}<extra></extra>')],
        'distance from the centre [px]', 'stars', height=330, bargap=0.0)
