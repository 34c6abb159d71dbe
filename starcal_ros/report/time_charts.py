# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The charts over time: convergence, equivalent principal point, consistency, whiteness."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
import plotly.graph_objects as go

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.distributions import chi2_ppf, normal_isf
from starcal_ros.core.units import NS
from starcal_ros.filter.history import History
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, UNIT
from starcal_ros.report.chart import BARS, BLUE, GREY, PALE, RED, Chart, chart
from starcal_ros.report.states import LABELS, SIGMA_UNITS, errors

POINTS = 2000
"""Points of a curve, at most."""
CONFIDENCE = 0.95
"""Of the band of the normalised innovation squared."""

_TIME = 'time [min]'
_IN_SIGHT = 1.5         # how far beyond the bounds a tolerance may stretch a chart
_LAGS = 40              # of the autocorrelation


def convergence(history: History, truth: dict[str, Any] | None, tolerance: Sequence[float],
                began: Sequence[float]) -> list[Chart]:
    """Return one chart a calibrated state: error, 3-sigma bound, tolerance, where it began.

    Parameters
    ----------
    history : History
    truth : dict or None
        Without it the error is the difference to the final estimate.
    tolerance : (13,) sequence
        Of the sigmas, in SIGMA_UNITS; three of them are drawn.
    began : (13,) sequence
        Error of the value that the calibration began with, likewise.
    """
    error = errors(history, truth)
    sigma = history.sigma[:, CALIBRATED] / UNIT[CALIBRATED]
    return [_bounded(f'{label} [{unit}], began {began[k]:+.3g} off', history, error[:, k],
                     sigma[:, k], 3.0 * tolerance[k], began[k])
            for k, (label, unit) in enumerate(zip(LABELS, SIGMA_UNITS))]


def equivalent_principal_point(history: History, truth: dict[str, Any] | None, pitch_mm: float
                               ) -> list[Chart]:
    """Return the charts of u0' and v0', Eq. (V.1) of `verdict`; T18 Fig. 9."""
    error = dict(zip(STATE_NAMES[CALIBRATED], (errors(history, truth) * UNIT[CALIBRATED]).T))
    scale = history.intrinsics[:, 2] / pitch_mm
    pairs = (('u0′ = u0 − (f/d) Ψ_y [px]', error['u0'] - scale * error['psi_y']),
             ('v0′ = v0 + (f/d) Ψ_x [px]', error['v0'] + scale * error['psi_x']))
    return [_bounded(title, history, value, history.equivalent_sigma[:, k])
            for k, (title, value) in enumerate(pairs)]


def consistency(history: History) -> tuple[Chart, str]:
    """Return the chart of the normalised innovation squared and what it says in words."""
    seen = history.used > 0
    freedom = 2 * history.used[seen]
    ratio = history.nis[seen] / freedom
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = (chi2_ppf(p, freedom) / freedom for p in (tail, 1.0 - tail))
    inside = np.mean((ratio >= low) & (ratio <= high))
    rows = thinned(len(ratio))
    x = _single(minutes(history)[seen][rows])
    stars = history.used[seen][rows]
    return chart(
        'Normalised innovation squared of a frame, over its degrees of freedom',
        [*(go.Scatter(x=x, y=_single(bound[rows]), mode='lines', hoverinfo='skip',
                      line={'color': GREY, 'width': 1}) for bound in (low, high)),
         go.Scatter(x=x, y=_single(ratio[rows]), mode='markers', customdata=stars,
                    marker={'color': BLUE, 'size': 3, 'opacity': 0.5},
                    hovertemplate='%{x:.2f} min: %{y:.3f}, %{customdata} stars<extra></extra>')],
        _TIME, '', wide=True, height=300), (
        f'{inside:.1%} of the frames lie inside the {CONFIDENCE:.0%} band of chi-square, '
        f'the mean is {ratio.mean():.3f}.')


def whiteness(history: History) -> tuple[Chart, str]:
    """Return the autocorrelation of the whitened turns, Eq. (C.1), and what it says in words.

    Where the model is right those of different frames know nothing of each other: of n pairs of
    three components the correlation is within 1.96 / sqrt(3 n) in 95 of 100 cases.
    """
    known = np.asarray(np.isfinite(history.turn).all(axis=-1))
    e = np.where(known[:, None], history.turn, 0.0)
    lags = np.arange(1, min(_LAGS, len(e) - 1) + 1)
    pairs = np.array([np.count_nonzero(known[k:] & known[:-k]) for k in lags])
    lags, pairs = lags[pairs > 0], pairs[pairs > 0]
    if not len(lags):
        return chart('Autocorrelation of the innovations', [], '', ''), (
            'There are too few frames for the autocorrelation of the innovations.')
    variance = np.sum(e**2) / (3.0 * known.sum())
    value = np.array([np.sum(e[k:] * e[:-k]) for k in lags]) / (3.0 * pairs * variance)
    band = normal_isf(0.5 * (1.0 - CONFIDENCE)) / np.sqrt(3.0 * pairs)
    inside = int(np.count_nonzero(np.abs(value) <= band))
    lags = lags * history.every
    return chart(
        'Autocorrelation of the innovations (their turns)',
        [*(go.Scatter(x=lags, y=sign * band, mode='lines', hoverinfo='skip',
                      line={'color': GREY, 'width': 1, 'dash': 'dash'}) for sign in (-1.0, 1.0)),
         go.Bar(x=lags, y=value, marker={'color': np.where(
             np.abs(value) <= band, BARS, RED).tolist()},
             hovertemplate='lag %{x}: %{y:.4f}<extra></extra>')],
        'lag [frames]', '', height=300), (
        f'Of {len(lags)} lags {inside} are inside the {CONFIDENCE:.0%} band; {CONFIDENCE:.0%} of '
        'them are expected to be where the innovations are white.')


def minutes(history: History) -> Array:
    """Return the time of each frame since the first [min]."""
    return (history.stamp_ns - history.stamp_ns[0]) * NS / 60.0


def thinned(n: int) -> Ints:
    """Return POINTS of the rows 0 to n - 1, evenly spread, or all of fewer."""
    return np.unique(np.linspace(0, n - 1, min(n, POINTS)).round().astype(np.int64))


def _bounded(title: str, history: History, error: Array, sigma: Array,
             tolerance: float | None = None, began: float | None = None) -> Chart:
    rows = thinned(len(error))
    x, bound = _single(minutes(history)[rows]), _single(3.0 * sigma[rows])
    # The first minutes would flatten all that follows.
    settled = 1.6 * 3.0 * sigma[len(sigma) // 5]
    edge = {'mode': 'lines', 'line': {'width': 0}, 'fillcolor': PALE}
    traces = [
        go.Scatter(x=x, y=-bound, hoverinfo='skip', **edge),
        go.Scatter(x=x, y=bound, fill='tonexty', **edge, name='3 sigma',
                   hovertemplate='%{y:.3g}'),
        go.Scatter(x=x, y=_single(error[rows]), mode='lines', name='error',
                   line={'color': BLUE, 'width': 1.2}, hovertemplate='%{y:.3g}')]
    if tolerance is not None:
        # In sight where it does not flatten the curve.
        settled = max(settled, 1.1 * tolerance if tolerance < _IN_SIGHT * settled else 0.0)
        if tolerance < settled:
            traces += [_level(x, sign * tolerance, GREY, 'dash') for sign in (-1.0, 1.0)]
    if began is not None and abs(began) < settled:
        traces.append(_level(x, began, RED, 'dot'))
    return chart(title, [*traces, _level(x, 0.0, RED, None)], _TIME, '', hovermode='x unified',
                 yaxis_range=[-settled, settled], xaxis_hoverformat='.2f')


def _level(x: NDArray[np.float32], y: float, color: str, dash: str | None) -> go.Scatter:
    return go.Scatter(x=x[[0, -1]], y=[y, y], mode='lines', hoverinfo='skip',
                      line={'color': color, 'width': 0.7 if dash is None else 1.0, 'dash': dash})


def _single(values: Array) -> NDArray[np.float32]:
    # Half the page; seven digits are more than a screen shows.
    return values.astype(np.float32)
