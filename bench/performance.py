# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""All that is measured of speed: `python bench/performance.py` writes docs/performance.md.

Runs the other scripts of this folder one after the other, each in a process of its own, and
writes what they print. To be run on a machine that does nothing else; what one of them needs and
does not find is said in its place.
"""

import ast
from datetime import date
from importlib.metadata import version
from itertools import chain
import os
from pathlib import Path
import platform
import subprocess
import sys
import time

from bars import MARK

BENCH = Path(__file__).resolve().parent
PAGE = BENCH.parent / 'docs' / 'performance.md'
SCRIPTS = ('calibrate.py', 'filterpy_peer.py', 'frame.py', 'start.py', 'long.py 1 6 24',
           'montecarlo.py', 'scale.py', 'cluster.py', 'live.py', 'latency.py', 'gyro_reading.py',
           'record.py', 'folder.py', 'images.py', 'image_peers.py', 'identify.py',
           'intrinsics_methods.py', 'interstar.py')
"""With their arguments."""
HEAD = """# Performance

Written by `python bench/performance.py`, which runs the scripts of `bench/` one after the other;
edit none of it. Times of different machines can not be compared, ratios within a script can.

* {day}, {cores} cores ({processor}), Python {python}, numpy {numpy}, numba {numba}
* one thread a library (`OPENBLAS_NUM_THREADS=1`)
* five million additions in Python, five times before all and five times after: {least:.2f} to
  {most:.2f} s. It tells how fast the machine is, and how even.

## What is aimed at

Of a machine of two cores that does nothing else; what is missed is said.

| what | measured | aimed at | |
|---|---|---|---|
{aims}
"""


def processor() -> str:
    """Return the name of the processor."""
    lines = Path('/proc/cpuinfo').read_text().splitlines()
    names = [line.partition(':')[2].strip() for line in lines if line.startswith('model name')]
    return names[0] if names else platform.machine()


def additions() -> float:
    """Return how long five million additions take [s]."""
    begin, total = time.perf_counter(), 0
    for k in range(5_000_000):
        total += k
    return time.perf_counter() - begin


def section(script: str) -> tuple[str, list[str]]:
    """Return what a script says of itself and prints, and what it says of what is aimed at."""
    name, *arguments = script.split()
    about = ast.get_docstring(ast.parse((BENCH / name).read_text())) or ''
    title, _, rest = about.partition('\n\n')
    print(script, file=sys.stderr, flush=True)
    done = subprocess.run([sys.executable, str(BENCH / name), *arguments], capture_output=True,
                          text=True, env={**os.environ, 'OPENBLAS_NUM_THREADS': '1'})
    # A script that misses what it aims at ends with 1; one that breaks has said nothing.
    last = '' if done.stdout else (done.stderr.strip().splitlines() or ['nothing said'])[-1]
    lines = done.stdout.rstrip().splitlines()
    printed = '\n'.join(line for line in lines if not line.startswith(MARK)) or (
        f'ended with status {done.returncode}: {last}')
    heading = title.partition(':')[0].rstrip('.')
    return (f'## {heading}\n\n`bench/{script}`\n\n{rest.strip()}\n\n```text\n{printed}\n```\n',
            [f'| {line.removeprefix(MARK)} |' for line in lines if line.startswith(MARK)])


def main() -> None:
    """Run all of them and write the page."""
    paces = [additions() for _ in range(5)]
    sections, aims = zip(*map(section, SCRIPTS))
    paces += [additions() for _ in range(5)]
    head = HEAD.format(
        least=min(paces), most=max(paces),
        aims='\n'.join(chain(*aims)),
        day=date.today().isoformat(), cores=len(os.sched_getaffinity(0)), processor=processor(),
        python=platform.python_version(), numpy=version('numpy'), numba=version('numba'))
    PAGE.write_text('\n'.join([head, *sections]))


if __name__ == '__main__':
    main()
