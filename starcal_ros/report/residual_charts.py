# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Residuals against all that they should not depend on.

Of each bin the mean, with twice its standard error, and the RMS are drawn. Places are those that
were predicted: the measured ones hold the very noise that is looked at, a star at rest would seem
displaced by its place in the pixel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.distributions import chi2_isf
from starcal_ros.report.chart import BLUE, GREY, RED, Chart, chart
from starcal_ros.report.states import short
from starcal_ros.sky import catalog

_BINS, _LEAST = 24, 10      # of a chart, at most, and stars of a bin, at least
_WORST = 8                  # stars that are listed
_CHANCE = 1e-3              # with which the bound on the worst star is passed


class StarResiduals(NamedTuple):
    """Residuals of the stars used.

    Attributes
    ----------
    residual : (m, 2) array
        Measured minus predicted [px].
    sigma : (m,) array
        Of each axis [px].
    uv : (m, 2) array
        Predicted places, from the centre of the detector [px].
    centre : (2,) array
        That centre, in raster pixels.
    catalog_id : (m,) int array
        Hipparcos numbers.
    """

    residual: Array
    sigma: Array
    uv: Array
    centre: Array
    catalog_id: Ints


def against(stars: StarResiduals, minutes: Array | None) -> list[Chart]:
    """Return the charts of residuals against time, magnitude, colour, radius and pixel phase.

    Parameters
    ----------
    stars : StarResiduals
    minutes : (m,) array, optional
        When they were seen; left out where time says nothing.
    """
    u, v = stars.residual.T
    radius = np.linalg.norm(stars.uv, axis=-1)
    outward = stars.uv / np.maximum(radius, 1e-9)[:, None]
    radial = np.sum(stars.residual * outward, axis=-1)
    across = stars.residual[:, 1] * outward[:, 0] - stars.residual[:, 0] * outward[:, 1]
    magnitude, colour = _known(stars.catalog_id)
    phase = stars.uv + stars.centre
    phase = phase - np.floor(phase + 0.5)
    axes = {'u': u, 'v': v}
    quantities = [('magnitude Hp', magnitude, axes), ('colour B − V', colour, axes),
                  ('distance from the centre [px]', radius, {'outward': radial, 'across': across})]
    if minutes is not None:
        quantities.insert(0, ('time [min]', minutes, axes))
    phases = [(f'{name}, place in the pixel [px]', part, {name: part_residual})
              for name, part, part_residual in (('u', phase[:, 0], u), ('v', phase[:, 1], v))]
    return [_mean(*each) for each in (*quantities, *phases) if _tells(each[1])] + [
        _rms(*each, stars.sigma) for each in quantities if _tells(each[1])]


def star_by_star(stars: StarResiduals) -> tuple[Chart | None, list[list[str]], str]:
    """Return the displacement of each star, the table of the most displaced, and words on both."""
    hip, which, n = np.unique(stars.catalog_id, return_inverse=True, return_counts=True)
    enough = (n >= _LEAST) & (hip > 0)
    if not enough.any():
        return None, [], f'No star was used {_LEAST} times.'
    mean = np.stack([np.bincount(which, part) / n for part in stars.residual.T], axis=-1)
    scaled = stars.residual / stars.sigma[:, None]
    chi = np.linalg.norm(np.stack([np.bincount(which, part) for part in scaled.T], axis=-1),
                         axis=-1) / np.sqrt(n)
    hip, n, mean, chi = hip[enough], n[enough], mean[enough], chi[enough]
    bound = float(np.sqrt(chi2_isf(_CHANCE / len(hip), 2)))
    magnitude, colour = _known(hip)
    order = np.argsort(-chi)[:_WORST]
    body = [[str(hip[k]), f'{magnitude[k]:.2f}',
             'unknown' if np.isnan(colour[k]) else f'{colour[k]:.2f}', str(n[k]),
             short(mean[k, 0]), short(mean[k, 1]), f'{chi[k]:.2f}'] for k in order]
    beyond = int(np.count_nonzero(chi > bound))
    ends = [float(n.min()), float(n.max())]
    figure = chart(
        'Displacement of each star, in sigmas of its mean',
        [go.Scatter(x=ends, y=[bound, bound], mode='lines', hoverinfo='skip',
                    line={'color': GREY, 'width': 1, 'dash': 'dash'}),
         go.Scatter(x=n, y=chi, mode='markers', customdata=hip,
                    marker={'color': np.where(chi > bound, RED, BLUE).tolist(), 'size': 4},
                    hovertemplate='HIP %{customdata}: %{y:.2f}, %{x} times<extra></extra>')],
        'times used', '', height=330, xaxis_type='log')
    return figure, body, (
        f'{beyond} of {len(hip)} stars are displaced beyond the dashed line, which chance passes '
        f'once in {1.0 / _CHANCE:.0f} runs.')


def _mean(name: str, x: Array, parts: dict[str, Array]) -> Chart:
    traces = []
    for (label, values), color in zip(parts.items(), (BLUE, RED)):
        middle, mean, error, _ = _binned(x, values)
        traces.append(go.Scatter(
            x=middle, y=mean, mode='lines+markers', name=label,
            line={'color': color, 'width': 1}, marker={'color': color, 'size': 4},
            error_y={'type': 'data', 'array': 2.0 * error, 'thickness': 0.8, 'width': 0,
                     'color': color},
            hovertemplate=f'{label}: %{{y:.2g}} px at %{{x:.3g}}<extra></extra>'))
    return chart(_title('Mean', parts, name), traces, name, '')


def _rms(name: str, x: Array, parts: dict[str, Array], sigma: Array) -> Chart:
    traces = [go.Scatter(
        x=middle, y=rms, mode='lines+markers', line={'color': color, 'width': 1},
        marker={'color': color, 'size': 4},
        hovertemplate=f'{label}: %{{y:.3g}} px at %{{x:.3g}}<extra></extra>')
        for (label, values), color in zip(parts.items(), (BLUE, RED))
        for middle, _, _, rms in [_binned(x, values)]]
    middle, _, _, stated = _binned(x, sigma)
    traces.append(go.Scatter(x=middle, y=stated, mode='lines', hoverinfo='skip',
                             line={'color': GREY, 'width': 1, 'dash': 'dash'}))
    return chart(_title('RMS', parts, name), traces, name, '', yaxis_rangemode='tozero')


def _title(what: str, parts: dict[str, Array], name: str) -> str:
    over = name.partition(' [')[0].partition(', ')[2] or name.partition(' [')[0]
    return f'{what} {" and ".join(parts)} [px] over {over}'


def _binned(x: Array, values: Array) -> tuple[Array, Array, Array, Array]:
    """Return middle, mean, its standard error and RMS of bins of like numbers of stars."""
    known = np.isfinite(x)
    x, values = x[known], values[known]
    bins = int(np.clip(len(x) // _LEAST, 1, _BINS))
    order = np.argsort(x, kind='stable')
    cuts = np.linspace(0, len(x), bins + 1).astype(int)
    n = np.diff(cuts)

    def per_bin(weights: Array) -> Array:
        return np.add.reduceat(weights[order], cuts[:-1]) / n

    mean = per_bin(values)
    mean_square = per_bin(values**2)
    error = np.sqrt(np.maximum(mean_square - mean**2, 0.0) / n)
    return per_bin(x), mean, error, np.sqrt(mean_square)


def _known(hip: Ints) -> tuple[Array, Array]:
    """Return magnitude and colour of stars by their numbers, NaN where they are not known."""
    known = catalog.load_containing(hip)
    rows = known.rows(hip)
    return (np.where(rows >= 0, known.magnitude[rows], np.nan),
            np.where(rows >= 0, known.colour[rows], np.nan))


def _tells(x: Array) -> bool:
    """Tell whether residuals can be drawn against a quantity: two bins of it at least."""
    known = x[np.isfinite(x)]
    return len(known) >= 2 * _LEAST and bool(np.ptp(known) > 0.0)
