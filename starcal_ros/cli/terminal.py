# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the command says: results on standard output, progress and messages on standard error.

A result is a table for a person, `show`, or JSON for a program, `show_json`: a command gives both,
and one of them is printed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
import json
import os
import sys
from typing import TYPE_CHECKING, Any

from starcal_ros.files.foreign import literal

if TYPE_CHECKING:
    from rich.table import Table

STATUS = {'converged': 0, 'consistent': 0, 'not yet': 3, 'inconsistent': 4, 'lost': 4}
"""Exit status of a calibration, by its verdict; the result is written in all of them."""

OUTPUT = 'standard output'

_UNBOUNDED = 1000       # characters
_AS_JSON = ContextVar('as_json', default=False)


@contextmanager
def printing(as_json: bool) -> Iterator[None]:
    """Print results as JSON, or as tables, while this lasts."""
    token = _AS_JSON.set(as_json)
    try:
        yield
    finally:
        _AS_JSON.reset(token)


@contextmanager
def progress(text: str) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on standard error; yield what moves it, from 0 to 1."""
    from rich.console import Console
    from rich.progress import (BarColumn, Progress, TaskProgressColumn, TextColumn,
                               TimeElapsedColumn)
    with Progress(TextColumn(f'{text:<12}'), BarColumn(), TaskProgressColumn(),
                  TimeElapsedColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task(text, total=1.0)
        yield lambda part: bar.update(task, completed=part)
        bar.update(task, completed=1.0)         # what it took is more than the last part told


@contextmanager
def onto_output() -> Iterator[None]:
    """Name standard output in an `OSError`, as the file that could not be written."""
    try:
        yield
    except OSError as error:
        error.filename = OUTPUT
        raise


def put(text: str) -> None:
    """Print a text as it is on standard output."""
    with onto_output():
        print(text)


def show(what: Table | str) -> None:
    """Print on standard output, but for JSON; a pipe is as wide as the widest table."""
    if _AS_JSON.get():
        return
    from rich.console import Console
    console = Console(highlight=False, soft_wrap=True)
    if not console.is_terminal:
        console = Console(highlight=False, soft_wrap=True, width=_UNBOUNDED)
    with onto_output():
        console.print(literal(what) if isinstance(what, str) else what)


def show_json(values: dict[str, Any] | list[dict[str, Any]]) -> None:
    """Print on standard output where JSON is asked for; NaN and infinity are refused."""
    if _AS_JSON.get():
        put(json.dumps(values, indent=1, allow_nan=False))


def say(text: str) -> None:
    """Print a message for the user on standard error."""
    from rich.console import Console
    Console(stderr=True, highlight=False, soft_wrap=True).print(literal(text))


def told(error: Exception) -> tuple[int, str]:
    """Return the exit status and the text of an error; raise it again where it is a defect."""
    from starcal_ros.config.parameter import ConfigError
    from starcal_ros.messages.cdr import RecordError
    from starcal_ros.workflows.node_program import NodeError
    if isinstance(error, (ConfigError, RecordError, FileNotFoundError)):
        return 2, str(error)
    if isinstance(error, (ValueError, NodeError)):
        return 1, str(error)
    if isinstance(error, OSError):
        if error.filename == OUTPUT:    # nothing goes there at the end of the process, too
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        place = f'{error.filename}: ' if error.filename else ''
        return 1, f'{place}{error.strerror or error}'
    raise error
