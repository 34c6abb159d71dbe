# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How a Monte Carlo grows with its workers: `python bench/scale.py`.

64 runs of ten minutes of T18's scenario on one core, then on each power of two that there is.
Beyond that the schedule's arithmetic: all batches but for the last round are full, so that w
workers take ``rounds x size`` runs of one worker's time a run, and the part that is not shared.
"""

import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from starcal_ros.evaluation.montecarlo import batch_size

RUNS, MINUTES, MOST = 64, 10, 64
CONFIG = Path(__file__).parents[1] / 'config' / 'tan2018.yaml'


def seconds(workers: int) -> float:
    """Return how long the study takes on some cores."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        subprocess.run(
            [sys.executable, '-m', 'starcal_ros.cli', 'montecarlo', '--config', str(CONFIG),
             '--runs', str(RUNS), '--duration', str(60 * MINUTES), '--out', f'{folder}/m.json'],
            check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env={**os.environ, 'OPENBLAS_NUM_THREADS': '1'},
            preexec_fn=lambda: os.sched_setaffinity(
                0, sorted(os.sched_getaffinity(0))[:workers]))
        return time.monotonic() - begin


def longest(workers: int) -> int:
    """Return how many runs the busiest worker makes."""
    size = batch_size(RUNS, workers)
    return size * -(-(-(-RUNS // size)) // workers)


def main() -> None:
    """Measure what can be measured here, and reckon the rest."""
    here, workers, measured = len(os.sched_getaffinity(0)), 1, {}
    while workers <= here:
        measured[workers] = seconds(workers)
        workers *= 2
    last = max(measured)
    # t = fixed + longest x run: from the two ends of what was measured.
    run = ((measured[1] - measured[last]) / (longest(1) - longest(last)) if last > 1
           else measured[1] / RUNS)
    fixed = measured[1] - longest(1) * run
    print(f'{RUNS} runs of {MINUTES} min; {run:.2f} s a run, {fixed:.2f} s not shared')
    workers = 1
    while workers <= MOST:
        took = measured.get(workers, fixed + longest(workers) * run)
        print(f'{workers:3d} workers {took:7.1f} s  {measured[1] / took:5.1f} times as fast  '
              f'{"measured" if workers in measured else "reckoned"}')
        workers *= 2


if __name__ == '__main__':
    main()
