# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Damaged files in great number: what became of them, for docs/reliability.md.

::

    PYTHONPATH=.:test python bench/fuzz.py 1000000 --seed 1 --out docs/reliability/fuzz.json

Kinds and damage are those of `test/fuzzed.py`, taken in turns. An input that raises what it must
not, or ends the process, or takes longer than 20 s, is kept in the folder --keep and counted.
"""

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
import hashlib
import json
from pathlib import Path
import resource
import signal
import tempfile
import time
import traceback

import numpy as np

from fuzzed import damage, is_held, kinds

SLOW_S = 20
BATCH = 1000


def stop(number, frame):
    """End an input that takes too long."""
    raise TimeoutError(f'longer than {SLOW_S} s')


def run(seed, count, keep):
    """Read so many damaged files; return the counts, the longest time and the peak memory [MB]."""
    rng, counts, longest = np.random.default_rng(seed), Counter(), 0.0
    signal.signal(signal.SIGALRM, stop)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        all_kinds = kinds(folder)
        for k in range(count):
            kind = all_kinds[k % len(all_kinds)]
            edits = [(rng.random(), int(rng.integers(6)), int(rng.integers(256)))
                     for _ in range(rng.integers(1, 4))]
            content = damage(kind.content, edits)
            (keep / f'last_{seed}_{kind.name}').write_bytes(content)
            begin = time.perf_counter()
            signal.alarm(SLOW_S)
            try:
                result = 'refused' if is_held(kind, content, folder) else 'read'
            except Exception:
                result = 'failed'
                digest = hashlib.sha256(content).hexdigest()[:12]
                (keep / f'{digest}_{kind.name}').write_bytes(content)
                (keep / f'{digest}.txt').write_text(traceback.format_exc())
            finally:
                signal.alarm(0)
            longest = max(longest, time.perf_counter() - begin)
            counts[kind.name, result] += 1
    for path in keep.glob(f'last_{seed}_*'):
        path.unlink()
    return counts, longest, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main():
    """Run and write what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('count', type=int, help='inputs')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--jobs', type=int, default=2)
    parser.add_argument('--seconds', type=float, default=np.inf,
                        help='end after so long; the result says how far it came')
    parser.add_argument('--keep', type=Path, default=Path('fuzz'), help='for what failed')
    parser.add_argument('--out', type=Path, help='JSON file to write; else it is printed')
    options = parser.parse_args()
    options.keep.mkdir(exist_ok=True)
    counts, longest, memory, begin = Counter(), 0.0, 0.0, time.perf_counter()
    seeds = iter(np.random.SeedSequence(options.seed).generate_state(
        -(-options.count // BATCH)).tolist())
    with ProcessPoolExecutor(options.jobs) as pool:
        pending = []
        try:
            while True:
                while len(pending) < options.jobs and (
                        time.perf_counter() - begin < options.seconds
                        and (seed := next(seeds, None)) is not None):
                    pending.append(pool.submit(run, seed, BATCH, options.keep))
                if not pending:
                    break
                part, seconds, megabytes = pending.pop(0).result()
                counts += part
                longest, memory = max(longest, seconds), max(memory, megabytes)
        except BrokenProcessPool:
            print(f'A process ended; the input is the last one in {options.keep}/')
    found = {'inputs': counts.total(), 'of': options.count, 'seed': options.seed,
             'jobs': options.jobs, 'seconds': round(time.perf_counter() - begin),
             'longest_s': round(longest, 2), 'largest_process_mb': round(memory),
             'kinds': {name: {result: counts[name, result]
                              for result in ('read', 'refused', 'failed')}
                       for name in dict.fromkeys(name for name, _ in counts)}}
    text = json.dumps(found, indent=1) + '\n'
    if options.out:
        options.out.write_text(text)
    else:
        print(text, end='')


if __name__ == '__main__':
    main()
