# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A reproduced table for the terminal, a reproduced figure as a PNG file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from starcal_ros.files.foreign import literal
from starcal_ros.files.output import whole
from starcal_ros.reproduction.outcome import Curve, Field, Outcome, Panel

_STYLES: dict[str, dict[str, Any]] = {
    'line': {'linewidth': 0.9},
    'points': {'linestyle': '', 'marker': '.', 'markersize': 2.0},
    'marked': {'marker': 'o', 'markersize': 4.0, 'linewidth': 1.0},
    'limit': {'linestyle': '--', 'linewidth': 1.0, 'color': '#555555'},
    'paper': {'linestyle': '', 'marker': 'x', 'markersize': 7.0, 'color': '#a50f15'},
}
_COLUMNS = 3        # panels side by side, at most


def published(outcome: Outcome) -> Table:
    """Return an outcome as a table, its notes below."""
    out = Table(title=literal(outcome.title), caption=literal('\n'.join(outcome.notes)),
                caption_justify='left')
    for name, cells in zip(outcome.columns, zip(*outcome.rows)):
        texts = all(isinstance(cell, str) for cell in cells)
        out.add_column(name, justify='left' if texts else 'right',
                       overflow='fold')
    group = outcome.rows[0][0]
    grouped = sum(row[0] == group for row in outcome.rows) > 1
    for row in outcome.rows:
        if row[0] != group and grouped:
            out.add_section()
        group = row[0]
        out.add_row(*(literal(cell) if isinstance(cell, str) else f'{cell:.3g}' for cell in row))
    return out


def draw(outcome: Outcome, path: str | Path) -> None:
    """Draw the panels of an outcome into a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = outcome.panels
    columns = min(_COLUMNS, len(panels)) if len(panels) != 4 else 2
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(4.6 * columns + 0.4, 3.2 * rows + 0.4), layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis, panel in zip(axes.flat, panels):
        _draw(figure, axis, panel)
    for axis in axes.flat[len(panels):]:
        axis.set_axis_off()
    figure.suptitle(outcome.title)
    with whole(path) as draft, draft.open('wb') as stream:
        figure.savefig(stream, format=Path(path).suffix[1:] or 'png', dpi=110)


def _draw(figure: Any, axis: Any, panel: Panel) -> None:
    for curve in panel.curves:
        _curve(axis, curve)
    if panel.field is not None:
        _field(figure, axis, panel.field)
    axis.set_title(panel.title, fontsize=10)
    axis.set_xlabel(panel.x, fontsize=9)
    axis.set_ylabel(panel.y, fontsize=9)
    axis.tick_params(labelsize=8)
    for name in panel.log:
        getattr(axis, f'set_{name}scale')('log')
    if panel.y_limits is not None:
        axis.set_ylim(panel.y_limits)
    if panel.field is None:
        axis.grid(alpha=0.3)
    if any(curve.label for curve in panel.curves):
        axis.legend(fontsize=7)


def _curve(axis: Any, curve: Curve) -> None:
    if curve.style == 'bars':
        width = np.diff(curve.x).min() if len(curve.x) > 1 else 1.0
        axis.bar(curve.x, curve.y, width=width, color='#9ecae1', label=curve.label or None)
        return
    line, = axis.plot(curve.x, curve.y, label=curve.label or None, **_STYLES[curve.style])
    if curve.spread is not None:
        axis.fill_between(curve.x, curve.y - curve.spread, curve.y + curve.spread,
                          color=line.get_color(), alpha=0.25, linewidth=0)


def _field(figure: Any, axis: Any, field: Field) -> None:
    mesh = axis.pcolormesh(field.x, field.y, field.z, cmap='cividis', shading='nearest')
    figure.colorbar(mesh, ax=axis)
    if field.vector is not None:
        step = max(1, len(field.x) // 12)
        thin = (slice(step // 2, None, step),) * 2
        axis.quiver(field.x[thin[1]], field.y[thin[0]], *np.moveaxis(field.vector[thin], -1, 0),
                    color='white', angles='xy')
    axis.set_aspect('equal')
    axis.invert_yaxis()
