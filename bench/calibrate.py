# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Time and memory of two hours of T18's scenario: `python bench/calibrate.py`.

Each command runs in a process of its own, as a user runs it. Prints the seconds from its start
until its file is there and until it has ended, and the largest resident memory. What is aimed at
is meant for two cores.
"""

from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time

from bars import told

HOURS = 2.0
AIMS = {'simulate': 4.0, 'calibrate': 3.0}
MEMORY_AIM_MB = 400.0


def run(*arguments: str) -> tuple[float, float]:
    """Run a sub-command; return its seconds to its file, the last word, and to its end."""
    begin = time.time()
    subprocess.run([sys.executable, '-m', 'starcal_ros.cli', *arguments], check=True,
                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return Path(arguments[-1]).stat().st_mtime - begin, time.time() - begin


def main() -> None:
    """Measure both commands."""
    config = str(Path(__file__).parents[1] / 'config' / 'tan2018.yaml')
    with tempfile.TemporaryDirectory() as folder:
        bag, out = f'{folder}/t18.mcap', f'{folder}/r.json'
        seconds = {
            'simulate': run('simulate', '--config', config, '--out', bag),
            'calibrate': run('calibrate', bag, '--config', config, '--out', out)}
    for name, (there, ended) in seconds.items():
        print(f'{name:<10} {there:6.2f} s, {HOURS * 3600.0 / there:6.0f} times real time; ended '
              f'after {ended:.2f} s')
    # The larger of the two: the system keeps the maximum over all children.
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
    print(f'memory     {memory:6.0f} MB')
    for name, (there, _) in seconds.items():
        told(f'starcal {name}, {HOURS:.0f} h', there, AIMS[name], 's')
    told(f'memory of the two, {HOURS:.0f} h', memory, MEMORY_AIM_MB, 'MB')


if __name__ == '__main__':
    main()
