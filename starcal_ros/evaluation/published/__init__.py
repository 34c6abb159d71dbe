# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables, one a file: the file's name is what ``starcal reproduce`` is given.

Each module has ``reproduce(scenario, runs, work, on_progress)``, which returns an `Outcome`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
import pkgutil
from typing import Any, cast

from starcal_ros.config import Scenario


@dataclass(frozen=True)
class Outcome:
    """A table reproduced.

    Attributes
    ----------
    title : str
        Which table, and from how many runs.
    columns : tuple of str
        Its head; the first column groups the rows.
    rows : tuple of tuples
        Text and numbers.
    notes : tuple of str
        What the paper does not state, or can not be met honestly.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str | float, ...], ...]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON, each row a dictionary."""
        return {'title': self.title, 'notes': list(self.notes),
                'rows': [dict(zip(self.columns, row)) for row in self.rows]}


BESIDE = ('column', 'state', 'unit', 'paper', 'ours', 'bound', 'ratio')
"""Head of a table that puts published numbers beside ours; ratio is ours over the bound."""

Reproduce = Callable[[Scenario, int, Path, Callable[[float], None]], Outcome]


def names() -> list[str]:
    """Return what can be reproduced."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__))


def load(name: str) -> Reproduce:
    """Return the function that reproduces a table."""
    return cast(Reproduce, import_module(f'{__name__}.{name}').reproduce)


NOT_STATED = ('T18 states neither slew rate, dwell nor stars a frame; ours are those of the '
              'scenario: 0.5 deg/s, 30 s, about 24 stars.')
BIAS_BELOW_BOUND = ('T18 Table 4 has the gyro bias to 3.5e-4 deg/h. Its stated random walk of '
                    '0.001 deg/sqrt(h) allows no unbiased estimator better than ARW / sqrt(T) = '
                    '7.1e-4 deg/h in two hours, so that can not be met honestly; its Table 5 '
                    '(7.7e-4) agrees with the bound.')
