# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the runs of a study go: the cores of this machine, or a Dask cluster."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from starcal_ros.config.parameter import ConfigError


def add_dask(parser: argparse.ArgumentParser) -> None:
    """Add the cluster."""
    parser.add_argument('--dask', metavar='ADDRESS',
                        help='scheduler of a Dask cluster to run on (needs the extra dask)')


@contextmanager
def spread(address: str | None) -> Iterator[None]:
    """Let joblib's tasks run on a Dask cluster where one is named.

    Raises
    ------
    ConfigError
        Where there is none.
    """
    if address is None:
        yield
        return
    try:
        from distributed import Client
        import joblib
    except ImportError:
        raise ConfigError("--dask: needs pip install 'starcal_ros[dask]'") from None
    try:
        client = Client(address, timeout=10)        # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise ConfigError(f'--dask: no scheduler answers at {address}: {error}') from None
    with client, joblib.parallel_config(backend='dask'):
        yield
