# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Error budget: what each error that the estimator does not model does to the 16 states.

Each source is switched on alone, with the same seeds as without it; the mean difference of the
errors, in the sigmas that the filter states, is what the source does.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from starcal_ros.config.scenario import Scenario
from starcal_ros.evaluation import montecarlo
from starcal_ros.evaluation.batch import Runs
from starcal_ros.evaluation.montecarlo import MonteCarlo
from starcal_ros.filter.states import STATE_NAMES
from starcal_ros.reproduction.outcome import Outcome

RUNS = 100
SOURCES: dict[str, dict[str, Any]] = {
    'scale 100 ppm': {'truth.gyro.scale_factor_ppm': (100.0, 100.0, 100.0)},
    'misaligned 20"': {'truth.gyro.misalignment_arcsec': (20.0,) * 6},
    'bias walk': {'truth.gyro.bias_random_walk_deg_h_sqrt_h': 0.01},
    'late 1 ms': {'truth.star_tracker.time_offset_s': 0.001},
    'smear': {'truth.star_tracker.smear': True},
    'drift 1"': {'truth.mounting_drift.sigma_arcsec': 1.0},
    'in orbit': {'truth.observer.velocity': 'orbit'},
    '1 % wrong': {'truth.star_tracker.misidentified_fraction': 0.01},
    '5 hot pixels': {'truth.star_tracker.hot_pixels_per_frame': 5},
}
NOTES = ('Mean difference of the errors to the same runs without the source, in stated sigmas; '
         'differences up to 2 / sqrt(runs) are chance where the source changes the noise.',
         'bias walk: 0.01 deg/h/sqrt(h), errors from the first bias. drift: Gauss-Markov of 1 h, '
         'errors from the mean mounting. in orbit: 500 km, believed at the geocentre. wrong: '
         'stars with the number of their neighbour. hot pixels: at fixed places in each frame.')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the scenario without and with each source."""
    cases: dict[str, dict[str, Any]] = {'none': {}, **SOURCES}
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
    return Outcome(f'Error budget in sigmas, mean of {runs} runs', ('state', *SOURCES),
                   tuple(rows), NOTES)
