# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The convergence of the estimates as a PNG file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from starcal_ros.core.units import NS
from starcal_ros.files.output import whole
from starcal_ros.filter.states import CALIBRATED, UNIT
from starcal_ros.report.states import LABELS, SIGMA_UNITS, errors

if TYPE_CHECKING:
    from starcal_ros.filter.history import History


def figure(history: History, truth: dict[str, Any] | None, path: str | Path) -> None:
    """Draw the estimates as they converge, with their 3-sigma bounds, into a PNG file.

    With a truth the errors are drawn, without it the difference to the final estimate.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    minutes = (history.stamp_ns - history.stamp_ns[0]) * NS / 60.0
    error = errors(history, truth)
    sigma = history.sigma[:, CALIBRATED] / UNIT[CALIBRATED]
    canvas = Figure(figsize=(12.0, 13.0), layout='constrained')
    FigureCanvasAgg(canvas)
    axes = canvas.subplots(5, 3, sharex=True)
    places = [*range(3), *range(3, 6), 6, 7, 8, 9, 10, 12, 13]
    for axis, column in zip(axes.flat[places], range(13)):
        axis.fill_between(minutes, -3.0 * sigma[:, column], 3.0 * sigma[:, column],
                          color='#9ecae1', label='±3 sigma', linewidth=0)
        axis.plot(minutes, error[:, column], color='#08306b', linewidth=0.9, label='error')
        axis.axhline(0.0, color='black', linewidth=0.5)
        settled = 3.0 * sigma[len(sigma) // 5, column]
        axis.set_ylim(-1.6 * settled, 1.6 * settled)
        axis.set_title(f'{LABELS[column]} [{SIGMA_UNITS[column]}]', fontsize=10)
        axis.ticklabel_format(axis='y', style='sci', scilimits=(-3, 3))
        axis.grid(alpha=0.3)
    for axis in (axes.flat[11], axes.flat[14]):
        axis.set_axis_off()
    for axis in (axes.flat[8], axes.flat[12], axes.flat[13]):
        axis.set_xlabel('time [min]')
        axis.tick_params(labelbottom=True)
    axes.flat[0].legend(loc='upper right', fontsize=8)
    against = 'truth' if truth is not None else 'final estimate'
    canvas.suptitle(f'Estimate minus {against}, with 3-sigma bounds; axes scaled to the bound at '
                    'one fifth of the run')
    with whole(path) as draft, draft.open('wb') as stream:
        canvas.savefig(stream, format=Path(path).suffix[1:] or 'png', dpi=110)
