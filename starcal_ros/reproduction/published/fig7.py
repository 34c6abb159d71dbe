# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18 Fig. 7: the distributions of the reprojection errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.distributions import normal_cdf
from starcal_ros.reproduction import traces
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.published import NOT_STATED
from starcal_ros.reproduction.published.fig6 import GROUPS, HELD_OUT

RUNS = traces.RUNS
COLUMNS = ('stars', 'quantity', 'unit', 'u', 'v', 'expected')
NO_NUMBERS = 'T18 gives no numbers for its Fig. 7.'
_BINS, _REACH = 60, 4.5     # of a histogram, and how far it goes, in sigmas


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Compare the histograms with the normal distribution that the filter expects."""
    trace = traces.of(scenario, runs, work, on_progress)
    rows: list[tuple[str | float, ...]] = []
    panels = []
    for name, held_out in GROUPS.items():
        which = trace.held_out == held_out
        residual, sigma = trace.residual[which], np.sqrt(trace.variance[which])
        spread = float(np.sqrt(np.mean(sigma**2)))
        rows += [(name, 'mean', 'px', *residual.mean(axis=0).tolist(), 0.0),
                 (name, 'sigma', 'px', *residual.std(axis=0).tolist(), spread)]
        rows += [(name, f'beyond {k} sigma', '%',
                  *(100.0 * (abs(residual) > k * sigma).mean(axis=0)).tolist(),
                  200.0 * float(normal_cdf(-k))) for k in (1, 2, 3)]
        panels += [_panel(f'{axis}, stars {name}', residual[:, k], spread)
                   for k, axis in enumerate('uv')]
    return Outcome(f'T18 Fig. 7, distributions of the reprojection errors, {runs} runs', COLUMNS,
                   tuple(rows), (NOT_STATED, NO_NUMBERS, HELD_OUT), tuple(panels))


def _panel(title: str, residual: Array, sigma: float) -> Panel:
    edges = np.linspace(-_REACH, _REACH, _BINS + 1) * sigma
    middle = 0.5 * (edges[1:] + edges[:-1])
    count, _ = np.histogram(residual, edges)
    return Panel(title, 'measured minus predicted [px]', 'stars', (
        Curve(middle, count.astype(np.float64), 'found', 'bars'),
        Curve(middle, len(residual) * np.diff(normal_cdf(edges / sigma)), 'expected', 'limit')))
