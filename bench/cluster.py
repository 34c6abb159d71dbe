# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How a Monte Carlo grows with the workers of a Dask cluster: `python bench/cluster.py`.

A campaign of T18's scenario on a local cluster (``distributed.LocalCluster``) that waits for it,
of one worker, of two and so on, up to a worker a core.
"""

import os

from distributed import LocalCluster
from scale import MINUTES, seconds

RUNS = 300


def by_dask(workers: int) -> float:
    """Return how long the campaign takes with some workers."""
    with LocalCluster(n_workers=workers, threads_per_worker=1, host='127.0.0.1',
                      dashboard_address=None) as cluster:
        return seconds(RUNS, len(os.sched_getaffinity(0)), '--dask', cluster.scheduler_address)


def main() -> None:
    """Print the times."""
    print(f'{RUNS} runs of {MINUTES} min')
    one = by_dask(1)
    print(f'1 worker   {one:6.1f} s')
    for workers in range(2, len(os.sched_getaffinity(0)) + 1):
        took = by_dask(workers)
        print(f'{workers} workers  {took:6.1f} s, {one / took:.1f} times as fast')


if __name__ == '__main__':
    main()
