# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Is the covariance true? RMS over the bound, NEES and NIS of T18's scenario, state by state."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.evaluation import consistency, montecarlo
from starcal_ros.evaluation.montecarlo import MonteCarlo
from starcal_ros.filter.states import N_STATES
from starcal_ros.reproduction import first_errors
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.published import NOT_STATED, chance

RUNS = 100
DRAWN_S = 1800.0
"""Length of the runs whose first errors are drawn, at most [s]."""
COLUMNS = ('state', 'unit', 'RMS', 'bound', 'ratio', 'stated sigma')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the scenario many times and hold the errors to the bound and to the covariance."""
    study = MonteCarlo(scenario, runs)
    results, = montecarlo.run(study, work, lambda part: on_progress(0.5 * part), bounded=True)
    summary = montecarlo.summarize(
        scenario, results, montecarlo.bound_at(scenario, work))
    rows = tuple((name, state['unit'], state['rms'], state['bound'], state['ratio'],
                  state['sigma']) for name, state in summary['states'].items())
    said = tuple(
        f'{name} {summary[f"{key}_mean"]:.{digits}f} {of}; a true filter has {low:.{digits}f} to '
        f'{high:.{digits}f} (95 %).' for name, key, digits, of, (low, high) in (
            ('NEES', 'nees', 2, 'at the end, of 16 states', summary['nees_interval_95']),
            ('NIS', 'nis', 4, 'over its degrees of freedom', summary['nis_interval_95'])))
    expected = consistency.mean_interval(N_STATES, runs, 0.95)
    length_s = min(DRAWN_S, scenario.simulation.duration_s)
    drawn = first_errors.nees(scenario.replace({'simulation.duration_s': length_s}), runs,
                              lambda part: on_progress(0.5 + 0.5 * part))
    summary |= {'nees_drawn_mean': float(drawn.mean()), 'nees_drawn_interval_95': [*expected]}
    said += (f'NEES {drawn.mean():.2f} of {runs} runs of {length_s / 60.0:.0f} min whose first '
             f'errors are drawn from the initial sigmas; a true filter has {expected.low:.2f} to '
             f'{expected.high:.2f} (95 %).',)
    minutes, middle = results.time[0] / 60.0, 0.5 * (expected.low + expected.high)
    nees = Panel('Mean NEES of the 16 states', 'time [min]', 'NEES', (
        Curve(minutes, np.full_like(minutes, middle), '95 % of a true filter', 'limit',
              np.full_like(minutes, 0.5 * (expected.high - expected.low))),
        Curve(minutes, results.nees.mean(axis=0), f'{runs} runs')))
    low, high = consistency.rms_interval(runs, 0.95)
    states = np.arange(1, N_STATES + 1).astype(np.float64)
    ratio = Panel('RMS over bound at the end', 'state, in the order of the table', 'ratio', (
        Curve(states, np.full_like(states, 0.5 * (low + high)), '95 % of an efficient filter',
              'limit', np.full_like(states, 0.5 * (high - low))),
        Curve(states, np.array([float(row[4]) for row in rows]), f'{runs} runs', 'marked')))
    return Outcome(f'Covariance, {runs} runs of the scenario of T18', COLUMNS, rows,
                   (*said, chance(runs), NOT_STATED), (nees, ratio), summary)
