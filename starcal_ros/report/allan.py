# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The noise of a gyro: table, lines of a parameter file, figure, and the same as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from starcal_ros.files.output import whole
from starcal_ros.measurements.allan import CONFIDENCE, TERMS, AllanCurve, Coefficient

_ARW, _WALK = 1, 3              # of `TERMS`
_COLOURS = ('#08306b', '#b2182b', '#1b7837')
_STYLES = (':', '--', '-.', (0, (8, 3)), (0, (1, 4)))


def noise_table(curves: Sequence[AllanCurve], title: str) -> Table:
    """Return the coefficients of the three axes with their intervals."""
    table = Table(title=title)
    for column in ('noise', 'unit', 'x', 'y', 'z'):
        table.add_column(column)
    for term, *known in zip(TERMS, *(curve.coefficients for curve in curves)):
        table.add_row(term.name, term.unit, *map(_cell, known))
    return table


def _cell(known: Coefficient) -> str:
    if known.value is None:
        return f'not known, < {known.high:.2g}'
    return f'{known.value:.3g} ({known.low:.3g} to {known.high:.3g})'


def parameter_lines(curves: Sequence[AllanCurve]) -> str:
    """Return the lines of a parameter file, for the noisiest of the three axes."""
    angle, bias = _largest(curves, _ARW), _largest(curves, _WALK)
    lines = ['/**:', '  ros__parameters:']
    notes = []
    for known, group, name, unit in (
            (angle, 'gyro', 'arw_deg_sqrt_h', 'deg/sqrt(h)'),
            (bias, 'estimator.process_noise', 'gyro_bias_deg_h_sqrt_h', 'deg/h/sqrt(h)')):
        if known.value is None:
            notes.append(f'    # {group}.{name}: not known, below {known.high:.2g} {unit}')
        else:
            lines.append(f'    {group}.{name}: {float(f"{known.value:.3g}")!r}'
                         f'    # {known.low:.3g} to {known.high:.3g} {unit}')
    return '\n'.join([*(lines if len(lines) > 2 else []), *notes])


def _largest(curves: Sequence[AllanCurve], term: int) -> Coefficient:
    known = [curve.coefficients[term] for curve in curves]
    return max(known, key=lambda each: (each.value or 0.0, each.high))


def noise_json(curves: Sequence[AllanCurve]) -> dict[str, Any]:
    """Return curves and coefficients by axis; a value that is not known is null."""
    return {'confidence': CONFIDENCE, 'axes': {axis: {
        'coefficients': {term.name.replace(' ', '_'): {
            **known._asdict(), 'unit': term.unit}
            for term, known in zip(TERMS, curve.coefficients)},
        'misfit': curve.misfit, 'tau_s': curve.tau_s.tolist(),
        **{f'{name}_deg_h': getattr(curve, name).tolist()
           for name in ('deviation', 'low', 'high', 'fitted')}}
        for axis, curve in zip('xyz', curves)}}


def noise_figure(curves: Sequence[AllanCurve], title: str, path: str | Path) -> None:
    """Draw the curves, what fits them and the terms that are known, into a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(12.0, 5.0), layout='constrained')
    FigureCanvasAgg(canvas)
    panels = canvas.subplots(1, 3, sharex=True, sharey=True)
    for panel, axis, curve, colour in zip(panels, 'xyz', curves, _COLOURS):
        panel.fill_between(curve.tau_s, curve.low, curve.high, color=colour, alpha=0.2,
                           linewidth=0, label=f'{100.0 * CONFIDENCE:.0f} % interval')
        panel.plot(curve.tau_s, curve.deviation, 'o', color=colour, markersize=4,
                   label='Allan deviation')
        panel.plot(curve.tau_s, curve.fitted, color=colour, linewidth=1.2, label='fit')
        for term, known, style in zip(TERMS, curve.coefficients, _STYLES):
            if known.value is not None:
                part = known.value / term.scale * np.sqrt(
                    term.factor * (curve.tau_s / 3600.0)**float(term.power))
                panel.plot(curve.tau_s, part, linestyle=style, color='black', linewidth=0.8,
                           label=f'{term.name} {known.value:.3g} {term.unit}')
        panel.set(xscale='log', yscale='log', title=axis, xlabel='tau [s]',
                  ylim=(0.3 * min(each.low.min() for each in curves),
                        3.0 * max(each.high.max() for each in curves)))
        panel.grid(alpha=0.3, which='both')
        panel.legend(fontsize=8, loc='upper right')
    panels[0].set_ylabel('deviation [deg/h]')
    canvas.suptitle(title)
    with whole(path) as draft, draft.open('wb') as stream:
        canvas.savefig(stream, format=Path(path).suffix[1:] or 'png', dpi=110)
