# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The charts over the detector and of the correlations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
import plotly.graph_objects as go

from starcal_ros.core import lenses
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.camera import Detector
from starcal_ros.core.distributions import normal_cdf
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.filter.history import Residuals
from starcal_ros.report.chart import BARS, RED, Chart, chart

CELLS = 16
"""Cells of the map of residuals, along each side of the detector."""

_GRID, _ARROWS = 64, 8      # cells of a map of distortion along each side, and arrows
_LONGEST = 1.5              # the longest arrow, in their spacing
_BINS, _REACH = 81, 4.5     # of a histogram, and how far it goes [sigma]


def residual_map(stars: Residuals, detector: Detector) -> Chart:
    """Return RMS and mean of the residuals of the stars used, cell by cell."""
    used = stars.accepted
    uv, residual = stars.uv_raster[used], stars.residual[used]
    cell = cell_of(uv, detector)

    def total(weight: Array | None = None) -> Array:
        return np.bincount(cell, weight, CELLS * CELLS).astype(np.float64)

    count = total()
    filled = np.where(count > 0, count, np.nan)
    mean = np.stack([total(part) / filled for part in residual.T], axis=-1)
    rms = np.sqrt(total(np.sum(residual**2, axis=-1)) / (2.0 * filled))
    place = places(detector, CELLS)
    arrows, scale = _arrows(place, mean, detector.width / CELLS)
    hover = ('u %{x:.0f}, v %{y:.0f} px<br>rms %{z:.4f} px, %{customdata[0]} stars<br>'
             'mean %{customdata[1]:.5f}, %{customdata[2]:.5f} px<extra></extra>')
    return _map(
        f'RMS of each axis; arrows: mean × {scale:g}', place, rms, [arrows], detector, hover,
        np.column_stack((count, mean)), 'px')


def colour_map(title: str, place: Array, values: Array, detector: Detector, unit: str) -> Chart:
    """Return the map of a number over the detector, (cells^2,) at the places of `places`."""
    return _map(title, place, values, [], detector,
                f'u %{{x:.0f}}, v %{{y:.0f}} px<br>%{{z:.3g}} {unit}<extra></extra>', None, unit)


def cell_of(uv_raster: Array, detector: Detector) -> Ints:
    """Return the cell of centroids [raster px] in a map of CELLS by CELLS, row by row."""
    column, row = (np.clip((part + 0.5) / size * CELLS, 0, CELLS - 1).astype(np.int64)
                   for part, size in zip(uv_raster.T, (detector.width, detector.height)))
    return np.asarray(row * CELLS + column)


def residual_histograms(stars: Residuals) -> list[Chart]:
    """Return the histograms of the residuals of the stars used, over their stated sigma."""
    edges = np.linspace(-_REACH, _REACH, _BINS + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    scaled = (stars.residual / stars.sigma[:, None])[stars.accepted]
    expected = len(scaled) * np.diff(normal_cdf(edges))
    charts = []
    for axis, values in zip('uv', scaled.T):
        count, _ = np.histogram(values, edges)
        charts.append(chart(
            f'Residual in {axis} [sigma of the centroid]',
            [go.Bar(x=middle, y=count, marker={'color': BARS},
                    hovertemplate='%{x:.2f}: %{y}<extra></extra>'),
             go.Scatter(x=middle, y=expected, mode='lines', line={'color': RED, 'width': 1.5},
                        hovertemplate='%{x:.2f}: %{y:.1f} expected<extra></extra>')],
            '', 'stars', height=330, bargap=0.0, yaxis_tickformat='d'))
    return charts


def distortion_map(title: str, detector: Detector, intrinsics: Array,
                   minus: Array | None = None, lens: LensModel | None = None) -> Chart:
    """Return the map of a camera's distortion, or of its difference to another's.

    Parameters
    ----------
    title : str
        What the map shows.
    detector : Detector
        Pixels.
    intrinsics : (p,) array
        Camera.
    minus : (p,) array, optional
        Camera whose distortion is taken off.
    lens : LensModel, optional
        What both are; T18's where it is not said.
    """
    model = lens or Tan2018Lens(detector.pitch_mm)

    def field(cells: int) -> tuple[Array, Array]:
        place = places(detector, cells)
        uv = place - detector.centre_raster
        shift = lenses.distortion(model, uv, intrinsics)
        if minus is not None:
            shift -= lenses.distortion(model, uv, minus)
        return place, shift

    return shift_map(title, field, detector)


def shift_map(title: str, field: Callable[[int], tuple[Array, Array]], detector: Detector
              ) -> Chart:
    """Return a map of shifts: their length in colours, and arrows.

    Parameters
    ----------
    title : str
        What the map shows.
    field : callable
        Gives places and shifts, (cells^2, 2) [px], by the cells along each side.
    detector : Detector
        Pixels.
    """
    place, shift = field(_GRID)
    size = np.linalg.norm(shift, axis=-1)
    arrows, scale = _arrows(*field(_ARROWS), detector.width / _ARROWS)
    return _map(
        f'{title}: ≤ {size.max():.3g} px' + (f', arrows × {scale:g}' if size.any() else ''),
        place, size, [arrows], detector, 'u %{x:.0f}, v %{y:.0f} px<br>%{z:.4f} px: '
        '%{customdata[0]:.4f}, %{customdata[1]:.4f}<extra></extra>', shift, 'px',
        zmin=0.0, zmax=size.max() or 1.0)


def correlation(names: tuple[str, ...], values: Array) -> Chart:
    """Return the matrix of correlations."""
    return chart(
        'Correlation of the states',
        [go.Heatmap(x=names, y=names, z=values, zmin=-1.0, zmax=1.0, colorscale='RdBu',
                    hovertemplate='%{x}, %{y}: %{z:.4f}<extra></extra>',
                    colorbar=_bar('1'))],
        '', '', height=380, yaxis_autorange='reversed', xaxis_tickangle=-90,
        xaxis_tickfont_size=10, yaxis_tickfont_size=10, xaxis_dtick=1, yaxis_dtick=1)


def _bar(unit: str) -> dict[str, object]:
    return {'thickness': 10, 'outlinewidth': 0, 'title': {'text': unit},
            'exponentformat': 'power'}


def places(detector: Detector, cells: int) -> Array:
    """Return the middle of each cell, row by row, (cells^2, 2) [raster px]."""
    u, v = ((np.arange(cells) + 0.5) * size / cells - 0.5
            for size in (detector.width, detector.height))
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _arrows(place: Array, vector: Array, spacing_px: float) -> tuple[go.Scatter, float]:
    """Return vectors as arrows from their places, and how many times they are enlarged."""
    length = np.linalg.norm(vector, axis=-1)
    place, vector = place[length > 0.0], vector[length > 0.0]
    scale = 1.0
    if len(vector):
        room = _LONGEST * spacing_px / np.nanmax(length)
        power = 10.0 ** np.floor(np.log10(room))
        scale = float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= room))
    gap = np.full_like(place, np.nan)
    u, v = np.stack((place, place + scale * vector, gap), axis=1).reshape(-1, 2).T
    return go.Scatter(
        x=u.astype(np.float32), y=v.astype(np.float32), mode='lines+markers', hoverinfo='skip',
        line={'color': 'white', 'width': 1},
        marker={'color': 'white', 'symbol': 'arrow', 'angleref': 'previous',
                'size': np.tile([0, 5, 0], len(place))}), scale


def _map(title: str, place: Array, z: Array, over: list[go.Scatter], detector: Detector,
         hover: str, customdata: Array | None, unit: str, **limits: float) -> Chart:
    heat = go.Heatmap(
        x=_square(place)[0, :, 0], y=_square(place)[:, 0, 1], z=_square(z),
        customdata=None if customdata is None else _square(customdata), hovertemplate=hover,
        colorscale='Cividis', colorbar=_bar(unit), **limits)
    return chart(
        title, [heat, *over], 'u [px]', 'v [px]', height=330,
        # As wide whatever the numbers at the colours: maps beside each other have one size.
        margin={'l': 58, 'r': 84, 't': 26, 'b': 42, 'autoexpand': False},
        xaxis_range=[-0.5, detector.width - 0.5], yaxis_range=[detector.height - 0.5, -0.5],
        xaxis_constrain='domain', yaxis_constrain='domain', yaxis_scaleanchor='x',
        xaxis_showgrid=False, yaxis_showgrid=False)


def _square(values: Array) -> NDArray[np.float32]:
    """Return the values of the cells of `places` as rows and columns."""
    cells = round(len(values)**0.5)
    return values.reshape(cells, cells, *values.shape[1:]).astype(np.float32)
