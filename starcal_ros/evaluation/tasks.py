# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Many independent tasks over the cores of this machine, or over a Dask cluster.

What a worker did that was lost is done again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
import sys
from typing import TYPE_CHECKING, Any, TypeVar

import joblib
import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.parameter import ConfigError
from starcal_ros.files.output import whole

if TYPE_CHECKING:
    from distributed import Client

T = TypeVar('T')

_CLUSTER: ContextVar[Client | None] = ContextVar('cluster', default=None)

_LOSSES = 3             # of a worker, one after the other, that end the study


@contextmanager
def on_cluster(client: Client) -> Iterator[None]:
    """Let tasks run on a Dask cluster while this lasts."""
    token = _CLUSTER.set(client)
    try:
        yield
    finally:
        _CLUSTER.reset(token)


def workers() -> int:
    """Return how many tasks run at once."""
    client = _CLUSTER.get()
    return int(joblib.effective_n_jobs(-1)) if client is None else (
        max(sum(client.ncores().values()), 1))          # type: ignore[no-untyped-call]


def each(task: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, T]]:
    """Run a task with each of some arguments; yield the number and the result of what is done.

    What a worker did that was lost is done again.

    Parameters
    ----------
    task : callable
        It, its arguments and its results go through pickle.
    arguments : sequence of tuple
        Of each task.

    Raises
    ------
    ConfigError
        Where workers are lost time and again before a task is done, or the cluster is.
    """
    client = _CLUSTER.get()
    return _on_cores(task, arguments) if client is None else _on_workers(client, task, arguments)


def _on_cores(task: Callable[..., T], arguments: Sequence[tuple[Any, ...]]
              ) -> Iterator[tuple[int, T]]:
    losses, missing = 0, list(range(len(arguments)))
    while missing:
        before = len(missing)
        try:
            for k, result in joblib.Parallel(n_jobs=-1, return_as='generator_unordered')(
                    joblib.delayed(_numbered)(k, task, arguments[k]) for k in missing):
                missing.remove(k)
                yield k, result
        except BrokenProcessPool:
            losses = losses + 1 if len(missing) == before else 1
            if losses == _LOSSES:
                raise ConfigError(
                    f'a worker was lost {losses} times before a task was done: is there memory '
                    'enough? What is done is kept') from None
            print('starcal_ros: a worker was lost; what it did is done again', file=sys.stderr)


def _on_workers(client: Client, task: Callable[..., T], arguments: Sequence[tuple[Any, ...]]
                ) -> Iterator[tuple[int, T]]:
    # By its own client: joblib waits for ever for a task whose workers are lost time and again.
    from distributed import KilledWorker, as_completed
    from distributed.client import FutureCancelledError
    from distributed.comm.core import CommClosedError
    numbers = {client.submit(task, *given, pure=False): k for k, given in enumerate(arguments)}
    try:
        for future in as_completed(list(numbers)):      # type: ignore[no-untyped-call]
            result = future.result()
            yield numbers.pop(future), result
    except (KilledWorker, FutureCancelledError, CommClosedError) as error:
        raise ConfigError(f'the Dask cluster: {error}. What is done is kept') from None
    finally:
        client.cancel(list(numbers))                    # type: ignore[no-untyped-call]


def complete(names: Sequence[Path], task: Callable[..., dict[str, NDArray[Any]]],
             arguments: Sequence[tuple[Any, ...]],
             on_progress: Callable[[float], None] = lambda part: None) -> None:
    """Run the tasks whose file is not there yet, as `each`; keep what they return as it comes.

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
    """
    missing = [k for k, name in enumerate(names) if not name.exists()]
    on_progress(1.0 - len(missing) / max(len(names), 1))
    for done, (k, arrays) in enumerate(each(task, [arguments[k] for k in missing]), start=1):
        save(names[missing[k]], arrays)
        on_progress(1.0 - (len(missing) - done) / len(names))


def save(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write an NPZ file so that it is there whole or not at all."""
    with whole(path) as draft, draft.open('wb') as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def _numbered(index: int, task: Callable[..., T], arguments: tuple[Any, ...]) -> tuple[int, T]:
    return index, task(*arguments)
