# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Many independent tasks over cores, or over a cluster, by joblib; what is done is kept.

Where they run is joblib's backend: the cores of this machine, unless the caller is inside
``joblib.parallel_config``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
import sys
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.parameter import ConfigError
from starcal_ros.files.output import whole

_LOSSES = 3             # of a worker, one after the other, that end the study


def workers() -> int:
    """Return how many tasks run at once."""
    return int(joblib.effective_n_jobs(-1))


def complete(names: Sequence[Path], task: Callable[..., dict[str, NDArray[Any]]],
             arguments: Sequence[tuple[Any, ...]],
             on_progress: Callable[[float], None] = lambda part: None) -> None:
    """Run the tasks whose file is not there yet; keep what each returns as soon as it is done.

    What a worker did that was lost is done again.

    Parameters
    ----------
    names : sequence of Path
        An NPZ file for each task, in a folder that exists.
    task : callable
        Returns the arrays of one file.
    arguments : sequence of tuple
        Of each task.
    on_progress : callable
        Called with the part done, 0 to 1.

    Raises
    ------
    ConfigError
        Where workers are lost time and again before a task is done.
    """
    losses, missing = 0, _missing(names)
    on_progress(1.0 - len(missing) / max(len(names), 1))
    while missing:
        before = len(missing)
        try:
            results = joblib.Parallel(n_jobs=-1, return_as='generator_unordered')(
                joblib.delayed(_numbered)(k, task, arguments[k]) for k in missing)
            for done, (k, arrays) in enumerate(results, start=1):
                save(names[k], arrays)
                on_progress(1.0 - (before - done) / len(names))
        except BrokenProcessPool:
            missing = _missing(names)
            losses = losses + 1 if len(missing) == before else 1
            if losses == _LOSSES:
                raise ConfigError(
                    f'a worker was lost {losses} times before a task was done: is there memory '
                    'enough? What is done is kept, the same command goes on') from None
            print('starcal_ros: a worker was lost; what it did is done again', file=sys.stderr)
            continue
        missing = _missing(names)


def save(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write an NPZ file so that it is there whole or not at all."""
    with whole(path) as draft, draft.open('wb') as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def _missing(names: Sequence[Path]) -> list[int]:
    return [k for k, name in enumerate(names) if not name.exists()]


def _numbered(index: int, task: Callable[..., dict[str, NDArray[Any]]],
              arguments: tuple[Any, ...]) -> tuple[int, dict[str, NDArray[Any]]]:
    return index, task(*arguments)
