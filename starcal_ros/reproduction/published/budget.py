# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Error budget: what each error that the estimator does not model does to the 16 states.

Each source is switched on alone, with the same seeds as without it; the mean difference of the
errors, in the sigmas that the filter states, is what the source does.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from starcal_ros.config import truth
from starcal_ros.config.scenario import Scenario
from starcal_ros.evaluation import montecarlo
from starcal_ros.evaluation.batch_results import Runs
from starcal_ros.evaluation.montecarlo import MonteCarlo
from starcal_ros.filter.states import STATE_NAMES
from starcal_ros.reproduction.outcome import Outcome
from starcal_ros.simulation import errors

RUNS = 100
HEADING = ('Mean difference of the errors to the same runs without the source, in stated sigmas; '
           'differences up to 2 / sqrt(runs) are chance where the source changes the noise.')


class BudgetCase(NamedTuple):
    """What is switched on, by label; its place among the columns, and a note below them."""

    order: float
    cases: dict[str, dict[str, Any]]
    note: str = ''


TRUE_VALUES = (
    BudgetCase(30, {'late 1 ms': {'truth.star_tracker.time_offset_s': 0.001}}),
    BudgetCase(60, {'in orbit': {'truth.observer.velocity': 'orbit'}},
               'in orbit: 500 km, believed at the geocentre.'),
)
"""True values that differ from the nominal ones, among the error sources found by name."""


def budget() -> list[BudgetCase]:
    """Return all that is switched on, one after the other."""
    found = [BudgetCase(truth.order(source), errors.examples(source), getattr(source, 'NOTE', ''))
             for source in truth.sources()]
    return sorted([*TRUE_VALUES, *found], key=lambda source: source.order)


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the scenario without and with each source."""
    sources = budget()
    cases: dict[str, dict[str, Any]] = {'none': {}}
    for source in sources:
        cases.update(source.cases)
    ends: list[Runs] = []
    for k, settings in enumerate(cases.values()):
        study = MonteCarlo(scenario.replace(settings), runs)
        ends += montecarlo.run(study, work)
        on_progress((k + 1) / len(cases))
    reference = ends[0].error[:, -1]
    shifts = [((end.error[:, -1] - reference) / end.sigma[:, -1]).mean(axis=0)
              for end in ends[1:]]
    rows: list[tuple[str | float, ...]] = [
        (name, *(float(shift[k]) for shift in shifts)) for k, name in enumerate(STATE_NAMES)]
    notes = ' '.join(source.note for source in sources if source.note)
    return Outcome(f'Error budget in sigmas, mean of {runs} runs', ('state', *list(cases)[1:]),
                   tuple(rows), (HEADING, notes))
