# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One chart of the page: a plotly figure with its caption."""

from __future__ import annotations

from typing import Any, NamedTuple

import plotly.graph_objects as go

BLUE, PALE, RED, GREY = '#08306b', 'rgba(107, 174, 214, 0.35)', '#a50f15', '#777777'
_LINE = {'showgrid': True, 'gridcolor': '#e6e6e6', 'zeroline': False, 'linecolor': '#999999',
         'ticks': 'outside', 'tickcolor': '#999999', 'ticklen': 3, 'automargin': True,
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
        margin={'l': 10, 'r': 10, 't': 26, 'b': 10}, paper_bgcolor='white', plot_bgcolor='white',
        font={'family': 'system-ui, sans-serif', 'size': 11, 'color': '#222222'})
    figure.update_xaxes(**_LINE, title_text=x)
    figure.update_yaxes(**_LINE, title_text=y)
    figure.update_layout(**layout)
    return Chart(title, figure, wide)
