# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18 Table 4: RMS errors under different star centroid accuracies, 100 runs each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from starcal_ros.config.scenario import Scenario
from starcal_ros.evaluation import consistency, montecarlo
from starcal_ros.evaluation.montecarlo import MonteCarlo
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, STATE_UNITS
from starcal_ros.reproduction.outcome import Outcome
from starcal_ros.reproduction.published import (BESIDE, BIAS_BELOW_BOUND, NOT_STATED, ONE_DRAW,
                                                chance)

RUNS = 100
KEY, VALUES = 'star_tracker.centroid_sigma_px', (0.0, 0.05, 0.10, 0.15, 0.20)
PAPER = {
    'epsilon_x': (3.2e-4, 3.8e-4, 3.6e-4, 3.5e-4, 3.7e-4),
    'epsilon_y': (3.4e-4, 3.4e-4, 3.5e-4, 3.4e-4, 3.3e-4),
    'epsilon_z': (3.8e-4, 3.9e-4, 3.5e-4, 3.7e-4, 3.8e-4),
    'psi_x': (0.5, 2.4, 4.4, 6.3, 9.6),
    'psi_y': (0.4, 2.1, 3.9, 5.8, 8.3),
    'psi_z': (0.4, 0.5, 0.6, 0.9, 0.9),
    'u0': (0.007, 0.041, 0.076, 0.112, 0.159),
    'v0': (0.006, 0.045, 0.083, 0.120, 0.182),
    'f': (2.6e-5, 3.0e-5, 7.3e-5, 1.5e-4, 2.7e-4),
    'k1': (4.3e-7, 3.7e-7, 4.5e-7, 8.8e-7, 1.7e-6),
    'k2': (7.2e-8, 7.7e-8, 9.4e-8, 1.1e-7, 1.5e-7),
    'p1': (3.1e-7, 3.7e-7, 4.8e-7, 6.3e-7, 8.7e-7),
    'p2': (2.9e-7, 3.4e-7, 4.8e-7, 6.3e-7, 9.4e-7),
}
NOISELESS = (
    'Centroids without noise are weighted as if of 1e-4 px: the filter needs some, and the bound '
    'is that of this weight, which says nothing of what is possible: there is no ratio to it. '
    'NEES and NIS are as low as they are for that reason. What is left of the camera at 0 px is '
    'no noise but what the linear model leaves out.')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the study of Table 4."""
    return swept(f'T18 Table 4, RMS of {runs} runs', MonteCarlo(scenario, runs, KEY, VALUES),
                 PAPER, (NOT_STATED, BIAS_BELOW_BOUND, NOISELESS), work, on_progress, VALUES[:1])


def swept(title: str, study: MonteCarlo, paper: Mapping[str, tuple[float, ...]],
          notes: tuple[str, ...], work: Path, on_progress: Callable[[float], None],
          assumed: Sequence[float] = ()) -> Outcome:
    """Run a study and put its numbers beside those of a paper, given by state.

    Values whose bound is that of an `assumed` weight have no ratio to it.
    """
    results = montecarlo.run(study, work, on_progress, bounded=True)
    points = [montecarlo.summarize(study.at(value), runs,
                                   montecarlo.bound_at(study.at(value), work))
              for value, runs in zip(study.values, results)]
    units = dict(zip(STATE_NAMES, STATE_UNITS))
    rows = tuple(
        (f'{study.key} = {value:g}', name, units[name], paper[name][k],
         *(point['states'][name][key] for key in ('rms', 'bound')),
         '' if value in assumed else point['states'][name]['ratio'])
        for k, (value, point) in enumerate(zip(study.values, points))
        for name in STATE_NAMES[CALIBRATED])
    return Outcome(title, BESIDE, rows,
                   (*notes, ONE_DRAW, _below(study, points, paper, assumed), chance(study.runs),
                    _consistent(points)))


def _below(study: MonteCarlo, points: Sequence[Mapping[str, Any]],
           paper: Mapping[str, tuple[float, ...]], assumed: Sequence[float]) -> str:
    """Say where a paper's RMS is below the bound by more than the chance of its runs."""
    least = consistency.rms_interval(RUNS, 0.999).low
    where = []
    for name in STATE_NAMES[CALIBRATED]:
        values = [f'{value:g}' for k, value in enumerate(study.values)
                  if value not in assumed
                  and paper[name][k] < least * points[k]['states'][name]['bound']]
        where += [f'{name} at {", ".join(values)}'] if values else []
    return (f'T18 is below {least:.2f} of the bound of our scenario, which chance lets a set of '
            f'{RUNS} runs be in one of 2000, ' + (
                f'in: {"; ".join(where)}.' if where else 'nowhere.'))


def _consistent(points: Sequence[Mapping[str, Any]]) -> str:
    """Say what NEES and NIS of each column are."""
    nees, nis = (', '.join(f'{point[f"{name}_mean"]:.{digits}f}' for point in points)
                 for name, digits in (('nees', 2), ('nis', 4)))
    low, high = points[0]['nees_interval_95']
    return (f'Mean NEES of the columns: {nees} (16 states, 95 %: {low:.2f} to {high:.2f}); NIS '
            f'over its degrees of freedom: {nis}.')
