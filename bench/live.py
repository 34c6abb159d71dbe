# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Speed and load of the running nodes: python bench/live.py.

Simulators, estimator and recorder, first as four processes and then in one, as fast as they go:
how many times faster than real time, and the processor time of each for a simulated second. Then
at real time: the part of one core that each takes, once the camera is known well enough for the
linear model, after some 30 s. Processor time does not depend on what else the machine does, speed
does: repeat it, and take the best.
"""

from __future__ import annotations

import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import tempfile
import time

from bars import told

from starcal_ros.config import parameter_file
from starcal_ros.config.scenario import Scenario
from starcal_ros.config.shipped import config_file
from starcal_ros.workflows import live_run, node_program

DURATION_S = 600.0
REAL_TIME_S = 100.0
FASTER, SHARE_PERCENT = 80.0, 7.0       # what is aimed at
NODES = ('recorder', 'estimator', 'star_tracker_sim', 'gyro_sim')
_TICK_S = 1.0 / os.sysconf('SC_CLK_TCK')


def start(name: str, folder: Path, *names: str) -> subprocess.Popen[str]:
    """Start a node, or several in one process."""
    command = node_program.node_command(name, {}, folder / 'config.yaml')
    command[4:4] = names
    return subprocess.Popen(command, text=True, env={
        **os.environ, **live_run.isolated('fastdds_loopback' if names else 'fastdds_demo')},
                            stderr=subprocess.PIPE if 'gyro_sim' in (name, *names) else None)


def wait_for(process: subprocess.Popen[str], percent: int) -> float:
    """Return when the gyro simulator in a process has come so far."""
    for line in process.stderr or ():
        if (match := re.search(r' (\d+) %$', line.rstrip())) and int(match[1]) >= percent:
            return time.monotonic()
    raise RuntimeError(f'the simulation ended with status {process.wait()}')


def processor_s(process: subprocess.Popen[str]) -> float:
    """Return the processor time that a process has used."""
    fields = Path(f'/proc/{process.pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) * _TICK_S


def run(scenario: Scenario, together: bool, begin_percent: int = 5
        ) -> tuple[float, dict[str, float]]:
    """Run the nodes; return simulated seconds a second, and the processor time of each for one."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / 'config.yaml').write_text(parameter_file.dump(scenario.replace({
            'recorder.output': str(folder / 'run.mcap'), 'estimator.wait_for_subscribers': 1,
            'simulation.wait_for_subscribers': 2, 'simulation.wait_for_simulators': 1})))
        nodes = ({'all': start('composed', folder, *NODES)} if together
                 else {name: start(name, folder) for name in NODES})
        try:
            simulator = nodes.get('gyro_sim') or nodes['all']
            began_s = wait_for(simulator, begin_percent)
            before = {name: processor_s(node) for name, node in nodes.items()}
            elapsed_s = wait_for(simulator, 95) - began_s
            simulated_s = 0.01 * (95 - begin_percent) * scenario.simulation.duration_s
            used = {name: (processor_s(node) - before[name]) / simulated_s
                    for name, node in nodes.items()}
        finally:
            for node in reversed(nodes.values()):
                node.send_signal(signal.SIGINT)
                node.communicate()
    return simulated_s / elapsed_s, used


def main() -> int:
    """Print the speeds and loads."""
    scenario = parameter_file.load(config_file('tan2018.yaml'))
    fast = scenario.replace({'simulation.duration_s': DURATION_S,
                             'simulation.real_time_factor': 0.0})
    speeds = []
    for together in (False, True):
        speed, used = run(fast, together)
        speeds.append(speed)
        print(f'{"one process" if together else "four processes":<15}{speed:6.1f} times real '
              'time; processor ms a simulated second: '
              + ', '.join(f'{name} {1e3 * seconds:.1f}' for name, seconds in used.items()))
    _, used = run(scenario.replace({'simulation.duration_s': REAL_TIME_S,
                                    'simulation.real_time_factor': 1.0}), False, 40)
    print('real time: ' + ', '.join(f'{name} {100.0 * part:.1f} %' for name, part in used.items())
          + ' of a core')
    met = (told('nodes faster than real time, four processes', speeds[0], FASTER, 'times', True),
           told('estimator at real time, of a core', 100.0 * used['estimator'], SHARE_PERCENT,
                '%'))
    return 0 if all(met) else 1


if __name__ == '__main__':
    sys.exit(main())
