# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Memory of the running nodes over hours: `python bench/live_memory.py 6`.

Simulators, estimator and recorder, four processes as fast as they go. Prints the resident memory
of each after ten simulated minutes, and by how much it has grown since at each further twelfth of
the run.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile

from live import NODES, start, wait_for

from starcal_ros.config import parameter_file
from starcal_ros.config.shipped import config_file

FIRST_S = 600.0
ALLOWED_MB = 5.0            # of growth of each


def resident_mb(process: subprocess.Popen[str]) -> float:
    """Return the memory that a process has of its own [MB]."""
    pages = Path(f'/proc/{process.pid}/statm').read_text().split()
    return (int(pages[1]) - int(pages[2])) * os.sysconf('SC_PAGE_SIZE') / 2**20


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('hours', type=float)
    options = parser.parse_args()
    scenario = parameter_file.load(config_file('tan2018.yaml')).replace({
        'simulation.duration_s': 3600.0 * options.hours,
        'simulation.real_time_factor': 0.0, 'estimator.wait_for_subscribers': 1,
        'simulation.wait_for_subscribers': 2})
    first = int(100.0 * FIRST_S / scenario.simulation.duration_s) + 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / 'config.yaml').write_text(parameter_file.dump(scenario.replace({
            'recorder.output': str(folder / 'run.mcap')})))
        nodes = {each: start(each, folder) for each in NODES}
        print('| h | ' + ' | '.join(f'{each} MB' for each in NODES) + ' |')
        print('|---' * (len(NODES) + 1) + '|')
        try:
            wait_for(nodes['gyro_sim'], first)
            before = {each: resident_mb(node) for each, node in nodes.items()}
            grown: dict[str, float] = dict.fromkeys(NODES, 0.0)
            for percent in (first, *range(8, 97, 8)):
                wait_for(nodes['gyro_sim'], percent)
                grown = {each: resident_mb(node) - before[each] for each, node in nodes.items()}
                print(f'| {options.hours * percent / 100.0:.2f} | ' + ' | '.join(
                    f'{before[each]:.1f} {grown[each]:+.1f}' for each in NODES) + ' |',
                    flush=True)
        finally:
            for node in reversed(nodes.values()):
                node.send_signal(signal.SIGINT)
                node.communicate()
    return 0 if max(grown.values()) <= ALLOWED_MB else 1


if __name__ == '__main__':
    sys.exit(main())
