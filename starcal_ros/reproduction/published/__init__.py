# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables and figures of the papers, one a file: its name is what ``starcal reproduce`` is given.

Names without a prefix are of T18 (Tan et al. 2018); a file ``w19_table2.py`` is ``w19-table2``.
Each module has ``RUNS``, how many runs it takes unless told otherwise, and
``reproduce(scenario, runs, work, on_progress)``, which returns an `Outcome`; ``work`` is a folder
for what an interrupted study goes on with.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
import pkgutil
from typing import Protocol, cast

from starcal_ros.config.scenario import Scenario
from starcal_ros.evaluation import consistency
from starcal_ros.reproduction.outcome import Outcome


class Reproduction(Protocol):
    """What a module of this package is."""

    RUNS: int

    def reproduce(self, scenario: Scenario, runs: int, work: Path,
                  on_progress: Callable[[float], None]) -> Outcome:
        """Run the study."""


BESIDE = ('column', 'state', 'unit', 'paper', 'ours', 'bound', 'ratio')
"""Head of a table that puts published numbers beside ours; ratio is ours over the bound."""


def names() -> list[str]:
    """Return what can be reproduced."""
    return sorted(module.name.replace('_', '-') for module in pkgutil.iter_modules(__path__))


def load(name: str) -> Reproduction:
    """Return the module that reproduces a table or figure."""
    return cast(Reproduction, import_module(f'{__name__}.{name.replace("-", "_")}'))


def chance(runs: int) -> str:
    """Say how far a ratio may be from 1."""
    low, high = consistency.rms_interval(runs, 0.95)
    return (f'ratio: RMS over bound; of an efficient filter it lies between {low:.2f} and '
            f'{high:.2f} in 95 % of all sets of {runs} independent errors.')


NOT_STATED = ('T18 states neither slew rate, dwell nor stars a frame; ours are those of the '
              'scenario: 0.5 deg/s, 30 s, about 24 stars.')
BIAS_BELOW_BOUND = (
    'T18 Table 4 has the gyro bias to 3.5e-4 deg/h. With the stated random walk of 0.001 '
    'deg/sqrt(h) no unbiased estimator is better than ARW / sqrt(T) = 7.1e-4 deg/h in two '
    'hours, so either the noise was another one, or the estimate used more than the readings, '
    'such as a bias that it began near; its Table 5 (7.7e-4) agrees with the bound.')
ONE_DRAW = (
    'All columns have the same seeds, so their draws of the noise are the same but for its '
    'size: a state that is off in one column is off in the others, too, and counts as one '
    'draw, not as several.')
