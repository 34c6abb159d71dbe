# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18 Fig. 6: reprojection errors over the last ten minutes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.reproduction import traces
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.published import NOT_STATED

RUNS = traces.RUNS
PAPER_PX = 0.05
COLUMNS = ('stars', 'axis', 'unit', 'paper', 'ours', 'expected', 'ratio')
GROUPS = {'used': False, 'held out': True}
HELD_OUT = ('held out: every fifth star of a frame, another fifth in the next, is predicted by an '
            'update of the frame without it. A star that is used draws the estimate towards its '
            'own noise, one held out is missed by the error of the prediction as well. expected: '
            'what the covariance of the filter says of each.')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Compare the residuals of stars used and of stars held out."""
    trace = traces.of(scenario, runs, work, on_progress)
    rows: list[tuple[str | float, ...]] = []
    panels = []
    for name, held_out in GROUPS.items():
        which = trace.held_out == held_out
        ours, expected = (np.sqrt(part[which].mean(axis=0)).tolist()
                          for part in (trace.residual**2, trace.variance))
        rows += [(name, axis, 'px', '-' if held_out else PAPER_PX, ours[k], expected[k],
                  ours[k] / expected[k]) for k, axis in enumerate('uv')]
        shown = np.flatnonzero(which & (trace.run == 0))
        shown = shown[::1 if held_out else traces.HELD_OUT]     # as many of both
        panels += [Panel(
            f'{axis}, stars {name}, one run', 'time [min]', 'measured minus predicted [px]',
            (Curve(trace.stamp[shown] / 60.0, trace.residual[shown, k], style='points'),),
            y_limits=(-5.0 * expected[k], 5.0 * expected[k])) for k, axis in enumerate('uv')]
    return Outcome(f'T18 Fig. 6, reprojection errors of ten minutes; table: RMS of {runs} runs',
                   COLUMNS, tuple(rows), (NOT_STATED, HELD_OUT), tuple(panels))
