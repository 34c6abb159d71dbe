# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18 Fig. 3: the estimates of all systematic errors over two hours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.models import mounting_matrix
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.evaluation import montecarlo
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, STATE_UNITS, UNIT
from starcal_ros.reproduction import traces
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.published import NOT_STATED, table3
from starcal_ros.simulation.truth import Truth

RUNS = traces.RUNS
PAPER = np.copysign(table3.PAPER, (-1, 1, -1, 1, -1, -1, 1, 1, 1, -1, -1, 1, -1))
"""With the signs of T18's estimates minus its truths."""
COLUMNS = ('state', 'unit', 'truth', 'paper', 'ours', 'bound', 'ratio', 'outside [%]')
ERRORS = ('paper, ours: estimate minus truth at the end of one run, ours with the seed of the '
          'scenario; ratio: size of our error over the bound, a draw of |N(0, 1)|. Psi is, as in '
          'T18 Table 3, what the nominal fixed angles are off by.')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Follow the estimates of the scenario's own seed; count 3 sigma over all runs."""
    trace = traces.of(scenario, runs, work, on_progress)
    error, sigma = (part[..., CALIBRATED] / UNIT[CALIBRATED]
                    for part in (trace.error, trace.sigma))
    bound = (montecarlo.bound(scenario) / UNIT)[CALIBRATED]
    outside = 100.0 * (abs(error) > 3.0 * sigma).mean(axis=(0, 1))
    names, units, last = STATE_NAMES[CALIBRATED], STATE_UNITS[CALIBRATED], error[0, -1]
    truth = _truth(scenario).tolist()
    rows = zip(names, units, truth, PAPER.tolist(), last.tolist(), bound.tolist(),
               (abs(last) / bound).tolist(), outside.tolist())
    panels = tuple(
        _panel(f'{name}, truth {value:g} {unit}', unit, trace.time / 60.0, error[0, :, k],
               sigma[0, :, k], first=k == 0)
        for k, (name, unit, value) in enumerate(zip(names, units, truth)))
    return Outcome(
        'T18 Fig. 3, all estimates of one run against the truth', COLUMNS, tuple(rows),
        (NOT_STATED, ERRORS, f'outside: errors beyond 3 stated sigma, all samples of {runs} runs; '
         '0.27 % of a true filter.'), panels)


def _truth(scenario: Scenario) -> Array:
    """Return the 13 true values, in STATE_UNITS."""
    truth = Truth.from_scenario(scenario)
    psi = rotation.log(mounting_matrix(scenario.mounting) @ truth.C_sg.T)
    return np.concatenate((truth.bias, psi, truth.intrinsics)) / UNIT[CALIBRATED]


def _panel(title: str, unit: str, minutes: Array, error: Array, sigma: Array, first: bool
           ) -> Panel:
    settled = 5.0 * float(sigma[len(sigma) // 5])
    return Panel(title, 'time [min]', f'estimate minus truth [{unit}]', (
        Curve(minutes, np.zeros_like(minutes), '0 ± 3 sigma' if first else '', 'limit',
              3.0 * sigma),
        Curve(minutes, error, 'error' if first else '')), y_limits=(-settled, settled))
