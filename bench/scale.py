# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How a Monte Carlo grows with its workers: `python bench/scale.py`.

A campaign of T18's scenario on one core, then on each power of two that there is. Beyond that
the schedule's arithmetic: the busiest worker makes so many runs, batch by batch, which takes as
long as one core takes for them, measured; and what the workers cost beside their runs is what it
is on as many as there are. Of the times of one core that are reckoned with the better of two tries
counts, since they are short.
"""

import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from bars import told

from starcal_ros.evaluation.montecarlo import batch_size

RUNS, MINUTES, MOST = 1000, 30, 16
AIMED_AT = 11.0             # times as fast on so many
CONFIG = Path(__file__).parents[1] / 'config' / 'tan2018.yaml'


def seconds(runs: int, workers: int, *more: str) -> float:
    """Return how long some runs take on some cores."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        subprocess.run(
            [sys.executable, '-m', 'starcal_ros.cli', 'montecarlo', '--config', str(CONFIG),
             '--runs', str(runs), '--duration', str(60 * MINUTES), '--out', f'{folder}/m.json',
             *more],
            check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env={**os.environ, 'OPENBLAS_NUM_THREADS': '1'},
            preexec_fn=lambda: os.sched_setaffinity(
                0, sorted(os.sched_getaffinity(0))[:workers]))
        return time.monotonic() - begin


def longest(workers: int) -> int:
    """Return how many runs the busiest worker makes."""
    size = batch_size(RUNS, workers)
    return size * -(-(-(-RUNS // size)) // workers)


def main() -> int:
    """Measure what can be measured here, and reckon the rest."""
    here, workers, took, how = len(os.sched_getaffinity(0)), 1, 0.0, 'measured'
    print(f'{RUNS} runs of {MINUTES} min')
    alone = beside = 0.0
    while workers <= MOST:
        own = min(seconds(longest(workers), 1) for _ in range(1 if workers <= here else 2))
        if workers <= here:
            took = own if workers == 1 else seconds(RUNS, workers)
            alone, beside = alone or took, max(took - own, 0.0)     # less is the noise of the two
        else:
            took, how = own + beside, 'reckoned'
        print(f'{workers:3d} workers {took:7.1f} s  {alone / took:5.1f} times as fast, {how}; '
              f'{longest(workers)} runs on one core {own:.1f} s')
        workers *= 2
    return 0 if told(f'Monte Carlo on {MOST} workers over one, {how}', alone / took, AIMED_AT,
                     'times', least=True) else 1


if __name__ == '__main__':
    sys.exit(main())
