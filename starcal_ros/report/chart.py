# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One chart of the page: a plotly figure with its caption."""

from __future__ import annotations

from typing import Any, NamedTuple

import plotly.graph_objects as go

BLUE, BARS, RED, GREY, TEXT, GRID = (
    '#08306b', '#9ecae1', '#a50f15', '#777777', '#222222', '#e6e6e6')
"""Colours; report.css has others for a dark screen, under the names of `ROLES`."""
PALE = 'rgba(107, 174, 214, 0.35)'
ROLES = {BLUE: 'curve', BARS: 'bars', RED: 'mark', GREY: 'bound', TEXT: 'text', GRID: 'grid'}

_CLEAR = 'rgba(0,0,0,0)'
_LINE = {'showgrid': True, 'gridcolor': GRID, 'zeroline': False, 'linecolor': GREY,
         'ticks': 'outside', 'tickcolor': GREY, 'ticklen': 3, 'automargin': True,
         'exponentformat': 'power', 'title': {'standoff': 6}}


class Chart(NamedTuple):
    """A figure and what it shows.

    Attributes
    ----------
    title : str
        Caption, plain text.
    figure : plotly figure
        Without width: the page gives it one.
    wide : bool
        Whether it needs the whole width of the page.
    """

    title: str
    figure: go.Figure
    wide: bool = False


def chart(title: str, traces: list[Any], x: str, y: str, wide: bool = False, height: int = 250,
          **layout: Any) -> Chart:
    """Return a chart in the style of the page; x and y name the axes."""
    figure = go.Figure(traces)
    figure.update_layout(
        template=go.layout.Template(), height=height, showlegend=False, hovermode='closest',
        margin={'l': 10, 'r': 10, 't': 26, 'b': 10}, paper_bgcolor=_CLEAR,
        plot_bgcolor=_CLEAR, modebar={'bgcolor': _CLEAR, 'color': GREY, 'activecolor': TEXT},
        font={'family': 'system-ui, sans-serif', 'size': 11, 'color': TEXT})
    figure.update_xaxes(**_LINE, title_text=x)
    figure.update_yaxes(**_LINE, title_text=y)
    figure.update_layout(**layout)
    return Chart(title, figure, wide)
