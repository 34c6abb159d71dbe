# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18 Table 3: the errors of one run of two hours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from starcal_ros.config.scenario import Scenario
from starcal_ros.evaluation import montecarlo
from starcal_ros.evaluation.batch_results import run_batch
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, STATE_UNITS, UNIT
from starcal_ros.reproduction.outcome import Outcome
from starcal_ros.reproduction.published import BESIDE, BIAS_BELOW_BOUND, NOT_STATED

RUNS = 1
PAPER = (0.0007, 0.0002, 0.0003, 1.8, 3.3, 0.8, 0.0546, 0.0334, 2e-5, 4e-7, 7.37e-8, 4.1e-8,
         5.8e-8)
ONE_RUN = ('One run: an error is a draw from its distribution, to be compared with the bound and '
           'not with the error of another run.')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the scenario once, with its own seed."""
    seed = scenario.simulation.seed
    error = abs(run_batch(scenario, [seed], on_progress).error[0, -1]) / UNIT
    bound = montecarlo.bound(scenario) / UNIT
    rows = zip(STATE_NAMES[CALIBRATED], STATE_UNITS[CALIBRATED], PAPER, error[CALIBRATED].tolist(),
               bound[CALIBRATED].tolist(), (error / bound)[CALIBRATED].tolist())
    return Outcome('T18 Table 3, one run', BESIDE, tuple((f'seed {seed}', *row) for row in rows),
                   (NOT_STATED, BIAS_BELOW_BOUND, ONE_RUN))
