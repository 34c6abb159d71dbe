# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the command says: results on standard output, progress and messages on standard error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from starcal_ros.files.foreign import literal

STATUS = {'converged': 0, 'consistent': 0, 'not yet': 3, 'inconsistent': 4, 'lost': 4}
"""Exit status of a calibration, by its verdict; the result is written in all of them."""

_UNBOUNDED = 1000       # characters


@contextmanager
def progress(text: str) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on standard error; yield what moves it, from 0 to 1."""
    with Progress(TextColumn(f'{text:<12}'), BarColumn(), TaskProgressColumn(),
                  TimeElapsedColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task(text, total=1.0)
        yield lambda part: bar.update(task, completed=part)


def show(what: Table | str) -> None:
    """Print on standard output; a file or a pipe is as wide as the widest table."""
    console = Console(highlight=False, soft_wrap=True)
    if not console.is_terminal:
        console = Console(highlight=False, soft_wrap=True, width=_UNBOUNDED)
    console.print(literal(what) if isinstance(what, str) else what)


def say(text: str) -> None:
    """Print a message for the user on standard error."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(literal(text))
