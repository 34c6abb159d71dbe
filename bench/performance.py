# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""All that is measured of speed: `python bench/performance.py` writes docs/performance.md.

Runs the other scripts of this folder one after the other, each in a process of its own, and
writes what they print. To be run on a machine that does nothing else; what one of them needs and
does not find is said in its place. What the page has of other machines beside what is aimed at
stays there.
"""

import ast
from datetime import date
from importlib.metadata import version
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

## What is aimed at

The aims are for two cores that do nothing else; each library has one thread
(`OPENBLAS_NUM_THREADS=1`). Misses are **bold**. Two rows without an aim tell how fast a machine
is: a loop in Python, the fastest and the slowest of ten before and after all else, and the peer.

{table}

The rest of this page is of {processor}, {day}: {cores} cores, Python {python}, numpy {numpy},
numba {numba}.
"""
TITLES = ['what', 'aimed at']


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


def section(script: str) -> tuple[str, list[list[str]]]:
    """Return what a script says of itself and prints, and its rows of the table."""
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
            [line.removeprefix(MARK).split(' | ') for line in lines if line.startswith(MARK)])


def rows_of(page: str) -> list[list[str]]:
    """Return the cells of the table of a page, its titles first; none where it has none."""
    head = f'| {" | ".join(TITLES)} |'
    lines = page.partition(f'\n{head}')[2].partition('\n\n')[0].splitlines()
    cells = [[cell.strip() for cell in line.strip('|').split('|')] for line in lines]
    return [[*TITLES, *cells[0]], *cells[2:]] if cells else [TITLES]


def table(page: str, machine: str, day: str, found: list[list[str]]) -> str:
    """Return the table with what was found on a machine first, and what a page has of others."""
    titles, *before = rows_of(page)
    others = [k for k, title in enumerate(titles) if k >= len(TITLES)
              and title.rpartition(', ')[0] != machine]
    known = {row[0]: row for row in before if any(row[k] for k in others)}
    new = {what: (aim, value) for what, aim, value in found}
    rows = [[*TITLES, f'{machine}, {day}', *(titles[k] for k in others)],
            ['---'] * (len(TITLES) + 1 + len(others))]
    for what in {**new, **known}:
        row = known.get(what, [''] * len(titles))
        rows.append([what, *new.get(what, (row[1], '')), *(row[k] for k in others)])
    return '\n'.join(f'| {" | ".join(row)} |' for row in rows)


def main() -> None:
    """Run all of them and write the page."""
    before = PAGE.read_text()
    paces = [additions() for _ in range(5)]
    sections, found = zip(*map(section, SCRIPTS))
    paces += [additions() for _ in range(5)]
    loop = ['five million additions in Python', '', f'{min(paces):.2f} to {max(paces):.2f} s']
    machine, day = processor(), date.today().isoformat()
    head = HEAD.format(
        table=table(before, machine, day, [loop, *sum(found, [])]), processor=machine,
        day=day, cores=len(os.sched_getaffinity(0)), python=platform.python_version(),
        numpy=version('numpy'), numba=version('numba'))
    PAGE.write_text('\n'.join([head, *sections]))


if __name__ == '__main__':
    main()
