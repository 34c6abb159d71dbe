# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the runs of a study go: the cores of this machine, or a Dask cluster."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
import logging
from typing import TYPE_CHECKING

import starcal_ros
from starcal_ros.config.parameter import ConfigError

if TYPE_CHECKING:
    from distributed import Client

_PATIENCE_S = 10


def add_dask(parser: argparse.ArgumentParser) -> None:
    """Add the cluster."""
    parser.add_argument('--dask', metavar='ADDRESS',
                        help='scheduler of a Dask cluster to run on (needs the extra dask)')


@contextmanager
def spread(address: str | None) -> Iterator[None]:
    """Let tasks run on a Dask cluster where one is named.

    Raises
    ------
    ConfigError
        Where there is none, or none with workers of this version of the package.
    """
    if address is None:
        yield
        return
    try:
        from distributed import Client
    except ImportError:
        raise ConfigError("--dask: needs pip install 'starcal_ros[dask]'") from None
    from starcal_ros.evaluation import tasks
    logging.getLogger('distributed.client').setLevel(logging.CRITICAL)  # it is told as errors
    try:
        client = Client(address, timeout=_PATIENCE_S)       # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise ConfigError(f'--dask: no scheduler answers at {address}: {error}') from None
    with client, tasks.on_cluster(client):
        _check(client, address)
        yield


def _check(client: Client, address: str) -> None:
    from starcal_ros.evaluation import tasks
    try:
        client.wait_for_workers(1, timeout=_PATIENCE_S)
    except (OSError, asyncio.TimeoutError):
        raise ConfigError(f'--dask: {address} has no worker') from None
    try:
        list(tasks.each(version, [()]))                     # the scheduler reads it as well
        there = set(client.run(version).values())
    except (ImportError, AttributeError, RuntimeError) as error:
        raise ConfigError(f'--dask: {address}: starcal_ros {starcal_ros.__version__} is to be '
                          f'installed there: {error.__cause__ or error}') from None
    if others := there - {starcal_ros.__version__}:
        raise ConfigError(f'--dask: workers of {address} have starcal_ros '
                          f'{", ".join(sorted(others))}, here is {starcal_ros.__version__}')


def version() -> str:
    """Return the version of this package where it is called."""
    return starcal_ros.__version__
