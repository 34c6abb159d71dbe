# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A chart of the page as a picture: the same figure, drawn by matplotlib into SVG.

What the charts of this package are made of is drawn: lines, bands, markers, arrows, bars, error
bars and maps. Curves are thinned to what a picture of this size shows.
"""

from __future__ import annotations

from html import escape
import io
import re
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
import numpy as np
import plotly.graph_objects as go

from starcal_ros.report.chart import GREY, GRID, TEXT, Chart

_WIDTH, _WIDE = 3.6, 11.0       # of a picture [inch]
_INCH = 100.0                   # pixels of the page
_POINTS, _BAND = 160, 60        # of a curve and of the edge of a band, at most
_FEW = 30                       # markers that are drawn upon a line
_HEAD = 0.25                    # of an arrow, part of its length
_DASHES = {'dash': '--', 'dot': ':'}
_TICKS = 5                      # of an axis, about
_STYLE: dict[Any, Any] = {
    'svg.fonttype': 'none', 'path.simplify': False, 'font.size': 7.0, 'text.color': TEXT,
    'axes.edgecolor': GREY, 'axes.labelcolor': TEXT, 'xtick.color': TEXT, 'ytick.color': TEXT,
    'axes.linewidth': 0.6, 'axes.spines.top': False, 'axes.spines.right': False,
    'grid.color': GRID, 'grid.linewidth': 0.5, 'axes.formatter.limits': (-3, 4),
    'axes.formatter.use_mathtext': False}


def svg(chart: Chart) -> str:
    """Return a chart as SVG, with its title as its label."""
    layout = chart.figure.layout
    # The salt makes names in the picture those of this chart, and no other's.
    with rc_context({**_STYLE, 'svg.hashsalt': chart.title}):
        figure = Figure(figsize=(_WIDE if chart.wide else _WIDTH, layout.height / _INCH),
                        layout='constrained')
        canvas = FigureCanvasSVG(figure)
        axes = figure.add_subplot()
        for behind in (figure.patch, axes.patch):
            behind.set_visible(False)
        axes.set_axisbelow(True)
        axes.grid(layout.xaxis.showgrid is not False)
        lower = np.empty(0)
        for trace in chart.figure.data:
            if isinstance(trace, go.Heatmap):
                _map(figure, axes, trace)
            elif isinstance(trace, go.Bar):
                axes.bar(trace.x, trace.y, np.diff(trace.x).min() if len(trace.x) > 1 else 1.0,
                         color=trace.marker.color)
            elif trace.fill == 'tonexty':
                rows = _thinned(len(trace.x), _BAND)
                axes.fill_between(np.asarray(trace.x)[rows], lower[rows],
                                  np.asarray(trace.y)[rows], facecolor=_rgba(trace.fillcolor),
                                  linewidth=0)
            else:
                _curve(axes, trace)
            lower = np.asarray(trace.y)
        _dress(axes, layout)
        stream = io.StringIO()
        # Without what changes from day to day.
        canvas.print_svg(                                 # type: ignore[no-untyped-call]
            stream, metadata=dict.fromkeys(('Date', 'Creator', 'Format', 'Type')))
    return _small(stream.getvalue(), chart.title)


def _curve(axes: Any, trace: go.Scatter) -> None:
    """Draw lines, markers, error bars; arrows come as two points and a gap."""
    x, y, mode = np.asarray(trace.x), np.asarray(trace.y), trace.mode
    if trace.marker.symbol == 'arrow':
        _arrows(axes, x.reshape(-1, 3)[:, :2], y.reshape(-1, 3)[:, :2], trace.line.color)
        return
    rows = _thinned(len(x))
    if trace.error_y.array is not None:
        error = np.asarray(trace.error_y.array)
        axes.plot(*_joined(x, x, y - error, y + error), color=trace.error_y.color,
                  linewidth=trace.error_y.thickness)
    if 'lines' in mode and trace.line.width != 0:
        axes.plot(x[rows], y[rows], color=trace.line.color, linewidth=0.8 * trace.line.width,
                  linestyle=_DASHES.get(trace.line.dash, '-'))
    if 'markers' in mode:
        color = trace.marker.color
        each = np.full(len(x), color) if isinstance(color, str) else np.asarray(color)
        for one in np.unique(each):
            # All of the colour that stands out; the line shows where the others are.
            dots = rows[each[rows] == one] if one == each[0] else np.flatnonzero(each == one)
            if 'lines' not in mode or one != trace.line.color or len(dots) <= _FEW:
                axes.plot(*_joined(x[dots], x[dots], y[dots], y[dots]), color=one,
                          linewidth=0.8 * trace.marker.size, solid_capstyle='round')


def _joined(x: Any, x_to: Any, y: Any, y_to: Any) -> Any:
    """Return lines of two points each as one curve with gaps: one path instead of many."""
    gap = np.full(len(x), np.nan)
    return (np.stack((x, x_to, gap), axis=-1).ravel(), np.stack((y, y_to, gap), axis=-1).ravel())


def _arrows(axes: Any, u: Any, v: Any, color: str) -> None:
    """Draw arrows from u[:, 0], v[:, 0] to u[:, 1], v[:, 1] as one curve with gaps."""
    du, dv, gap = -_HEAD * np.diff(u)[:, 0], -_HEAD * np.diff(v)[:, 0], np.full(len(u), np.nan)
    x = np.stack((u[:, 0], u[:, 1], u[:, 1] + du - dv, gap, u[:, 1], u[:, 1] + du + dv, gap))
    y = np.stack((v[:, 0], v[:, 1], v[:, 1] + dv + du, gap, v[:, 1], v[:, 1] + dv - du, gap))
    axes.plot(x.T.ravel(), y.T.ravel(), color=color, linewidth=0.6)


def _map(figure: Figure, axes: Any, trace: go.Heatmap) -> None:
    z = np.array(trace.z, dtype=float)
    rows, columns = z.shape
    named = isinstance(trace.x[0], str)
    x, y = (np.arange(n) if named else np.asarray(part)
            for n, part in ((columns, trace.x), (rows, trace.y)))
    dx, dy = (0.5 * (part[-1] - part[0]) / (len(part) - 1) for part in (x, y))
    drawn = axes.imshow(
        z, origin='lower', extent=(x[0] - dx, x[-1] + dx, y[0] - dy, y[-1] + dy),
        cmap='RdBu' if trace.zmin == -1.0 else 'cividis', vmin=trace.zmin, vmax=trace.zmax,
        aspect='equal', interpolation='nearest')
    bar = figure.colorbar(drawn, ax=axes, shrink=0.9, aspect=25, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.set_title(trace.colorbar.title.text or '', fontsize=7)
    if named:
        axes.set_xticks(x, trace.x, rotation=90, fontsize=5.5)
        axes.set_yticks(y, trace.y, fontsize=5.5)


def _dress(axes: Any, layout: Any) -> None:
    for name, axis in (('x', layout.xaxis), ('y', layout.yaxis)):
        getattr(axes, f'set_{name}label')(axis.title.text or '')
        if axis.type == 'log':
            getattr(axes, f'set_{name}scale')('log')
        if axis.range is not None:
            low, high = axis.range
            if axis.type == 'log':
                low, high = 10.0**low, 10.0**high
            getattr(axes, f'set_{name}lim')(low, high)
        elif axis.autorange == 'reversed':
            getattr(axes, f'invert_{name}axis')()
        elif axis.rangemode == 'tozero':
            getattr(axes, f'set_{name}lim')(0.0)
        if axis.tickvals is not None:
            getattr(axes, f'set_{name}ticks')(axis.tickvals, axis.ticktext)
        elif axis.type != 'log' and axis.dtick is None:
            axes.locator_params(name, nbins=_TICKS)


def _thinned(n: int, most: int = _POINTS) -> Any:
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def _rgba(text: str) -> Any:
    """Return the colour that CSS writes as rgba(...)."""
    if not text.startswith('rgba'):
        return to_rgba(text)
    *rgb, alpha = (float(part) for part in text[5:-1].split(','))
    return (*(part / 255.0 for part in rgb), alpha)


def _dot(place: re.Match[str]) -> str:
    return f'M{place[1]} {place[2]}L{float(place[1]) + 0.1:.1f} {place[2]}'


_HEAD_OF_SVG = re.compile(r'<svg [^>]*viewBox="([^"]*)"[^>]*>')
_NEEDLESS = re.compile(r'<!--.*?-->|<metadata>.*?</metadata>|<style type="text/css">.*?</style>',
                       re.S)
_OF_A_TAG = (
    (re.compile(r'\s+'), ' '),
    (re.compile(r' font-family: [^;]*;|; stroke-linecap: square| transform="rotate\(-0[^"]*"'),
     ''),
    (re.compile(r'(\d+\.\d)\d+'), r'\1'), (re.compile(r'([MLz]) (?=[\d-])'), r'\1'),
    (re.compile(r' (?=[MLz"])|(?<=[:;]) (?=[\w#(])'), ''),
    # A dot; lines of no length at all are not drawn everywhere.
    (re.compile(r'M([\d.]+) ([\d.]+)L\1 \2(?=[M"])'), _dot))


def _small(text: str, label: str) -> str:
    """Return an SVG without what a page needs not: its head, names, digits that nobody sees."""
    text = _NEEDLESS.sub('', text[text.index('<svg'):])
    used = set(re.findall(r'(?:href="|url\()#(\w+)', text))
    text = re.sub(r' id="([\w.]+)"', lambda name: name[0] if name[1] in used else '', text)
    text = re.sub(r'<[^>]*>', _short_tag, text)
    text = re.sub(r'>\s+<', '><', text).replace('<g></g>', '').replace('<defs></defs>', '')
    text = re.sub(r'<g>(<(?:use|text|path)[^<>]*/>)</g>', r'\1', text)
    return _HEAD_OF_SVG.sub(
        lambda head: f'<svg role="img" aria-label="{escape(label)}" viewBox="{head[1]}" '
        'font-family="sans-serif" xmlns="http://www.w3.org/2000/svg" '
        'xmlns:xlink="http://www.w3.org/1999/xlink">', text, count=1).strip()


def _short_tag(tag: re.Match[str]) -> str:
    text = tag[0]
    for pattern, instead in _OF_A_TAG:
        text = pattern.sub(instead, text)
    return text
