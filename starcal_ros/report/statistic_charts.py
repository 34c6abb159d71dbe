# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The tests of the innovations over time, each in its band.

Values and bands of the tests are of all sizes, and the bands grow narrower as a run goes on, so
each value is drawn by its place in the band: -1 at the lower end, 1 at the upper. What is beyond
is drawn by its logarithm, 2 where it is ten half widths away from the middle: the band stays in
sight however far out a value is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from starcal_ros.core.arrays import Array
from starcal_ros.core.statistic import Statistic
from starcal_ros.core.units import NS
from starcal_ros.report.chart import BLUE, PALE, RED, Chart, chart

_LEAST = 1.6            # extent of a chart to either side, at least


def statistics(tests: Sequence[tuple[int, Sequence[Statistic]]], start_ns: int) -> list[Chart]:
    """Return a chart of each test, those that fail in the end first.

    Parameters
    ----------
    tests : sequence of (int, sequence of Statistic)
        What they were, by their stamps, the last ones at the end of the run.
    start_ns : int
        Stamp from which the time is counted.
    """
    if not tests:
        return []
    last = sorted(tests[-1][1], key=lambda each: each.passed)
    return [_chart([((stamp_ns - start_ns) * NS / 60.0, each) for stamp_ns, row in tests
                    for each in row if each.name == final.name]) for final in last]


def place(value: Array, low: Array, high: Array) -> Array:
    """Return where values are drawn, by their places in their bands."""
    linear = (2.0 * value - low - high) / (high - low)
    beyond = np.maximum(np.abs(linear), 1.0)
    return np.where(np.abs(linear) <= 1.0, linear, np.sign(linear) * (1.0 + np.log10(beyond)))


def _chart(rows: list[tuple[float, Statistic]]) -> Chart:
    minutes = np.array([minute for minute, _ in rows])
    values, low, high = np.array([(each.value, each.low, each.high) for _, each in rows]).T
    y, final = place(values, low, high), rows[-1][1]
    out = np.array([not each.passed for _, each in rows])
    color = BLUE if final.passed else RED
    extent = max(_LEAST, 1.1 * float(np.abs(y).max()))
    ticks = np.arange(-int(extent), int(extent) + 1)
    told = np.stack((values, low, high), axis=-1)
    edge = {'mode': 'lines', 'line': {'width': 0}, 'fillcolor': PALE, 'hoverinfo': 'skip'}
    ends = [min(0.0, float(minutes[0])), float(minutes[-1])]
    return chart(
        f'{"" if final.passed else "Fails: "}{final.name} {final.value + 0.0:.3g}, '
        f'allowed {final.low:.3g} to {final.high:.3g}',
        [go.Scatter(x=ends, y=[-1.0, -1.0], **edge),
         go.Scatter(x=ends, y=[1.0, 1.0], fill='tonexty', **edge),
         go.Scatter(x=minutes, y=y, mode='lines+markers', customdata=told,
                    line={'color': color, 'width': 1.2},
                    marker={'color': np.where(out, RED, BLUE).tolist(), 'size': 4},
                    hovertemplate='%{x:.1f} min: %{customdata[0]:.4g}, allowed '
                    '%{customdata[1]:.4g} to %{customdata[2]:.4g}<extra></extra>')],
        'time [min]', '', height=190, yaxis_range=[-extent, extent],
        yaxis_tickvals=ticks.tolist(), yaxis_ticktext=[_tick(tick) for tick in ticks.tolist()])


def _tick(tick: int) -> str:
    ends = {-1: 'low', 0: '', 1: 'high'}
    return ends.get(tick, f'{"−" if tick < 0 else ""}{10**(abs(tick) - 1):g} ×')
