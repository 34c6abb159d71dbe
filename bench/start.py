# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How long commands and nodes take to start: python bench/start.py [COMMAND|NODE ...].

Of a command the time until it ends: the help, and `starcal info` of two hours. Of a node the time
from its start to its first message, as a subscriber in another process has it; of one that speaks
when it is spoken to, until another process sees that it listens. The processor time is that of the
process; it depends less on what else the machine does. The best of several runs counts: the first
one compiles. ``python -X importtime -m starcal_ros.cli COMMAND`` tells what takes how long.
"""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import Any, NamedTuple

from bars import told
from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Imu, PointCloud2

from starcal_ros.config import parameter_file
from starcal_ros.config.shipped import config_file
from starcal_ros.simulation.write_recording import simulate
from starcal_ros.workflows.live_run import isolated
from starcal_ros.workflows.node_program import node_command

REPEATS = 5
COMMAND_S, NODE_S = {'help': 0.3, 'info': 0.6}, 2.0     # what is aimed at
PATIENCE_S = 30.0
FIRST = {'gyro_sim': (Imu, 'imu/data_raw'),
         'star_tracker_sim': (PointCloud2, 'star_tracker/centroids'),
         'player': (Imu, 'imu/data_raw'),
         'estimator': (DiagnosticArray, 'diagnostics')}
"""What the first message of a node is."""
LISTENS = {'intrinsics_estimator': 'star_tracker/centroids',
           'centroid_extractor': 'star_tracker/image_raw',
           'star_identifier': 'star_tracker/spots'}
"""What the others listen to."""


class Took(NamedTuple):
    """Time that passed, and processor time [s]."""

    wall_s: float
    busy_s: float


def of_command(*words: str) -> Took:
    """Run a command."""
    before, begins = os.times(), time.monotonic()
    subprocess.run([sys.executable, '-m', 'starcal_ros.cli', *words], check=True,
                   stdout=subprocess.DEVNULL)
    return Took(time.monotonic() - begins, _children_s() - _children_s(before))


def of_node(listener: Node, name: str, bag: Path) -> Took:
    """Run a node until its first message has arrived, or it listens."""
    heard: list[float] = []
    kind, topic = FIRST.get(name) or (None, LISTENS[name])
    subscription = kind and listener.create_subscription(
        kind, topic, lambda message: heard.append(time.monotonic()), 10)
    before, begins = os.times(), time.monotonic()
    process = subprocess.Popen(node_command(name, {'player.bag': bag} if name == 'player' else {}),
                               stderr=subprocess.DEVNULL)
    try:
        while not heard:
            rclpy.spin_once(listener, timeout_sec=0.01)
            if subscription is None and listener.count_subscribers(topic):
                heard.append(time.monotonic())
            if process.poll() is not None or time.monotonic() > begins + PATIENCE_S:
                raise RuntimeError(f'{name}: nothing on {topic}')
    finally:
        process.terminate()             # so that it leaves the graph at once
        process.wait()
        if subscription is not None:
            listener.destroy_subscription(subscription)
    return Took(heard[0] - begins, _children_s() - _children_s(before))


def _children_s(times: Any = None) -> float:
    times = times or os.times()
    return float(times.children_user + times.children_system)


def best(name: str, run: Callable[[], Took]) -> float:
    """Print the best of several runs as a row; return the time [s]."""
    runs = [run() for _ in range(REPEATS)]
    wall_s = min(took.wall_s for took in runs)
    print(f'| {name} | {wall_s:.2f} | {min(took.busy_s for took in runs):.2f} |', flush=True)
    return wall_s


def main(names: list[str]) -> int:
    """Print a table."""
    os.environ.update(isolated())
    rclpy.init()
    listener = rclpy.create_node('listener')
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder, 'run.mcap')
        simulate(parameter_file.load(config_file('tan2018.yaml')), bag)
        commands = {'help': ('--help',), 'info': ('info', str(bag))}
        print('| what | time [s] | processor time [s] |\n|---|---|---|')
        commanded, spoke = {}, {}
        for name, words in commands.items():
            if not names or name in names:
                commanded[name] = best(f'starcal {words[0]}', lambda: of_command(*words))
        for name in (*FIRST, *LISTENS):
            if not names or name in names:
                spoke[name] = best(name, lambda: of_node(listener, name, bag))
    rclpy.shutdown()
    for name, took_s in commanded.items():
        told(f'starcal {commands[name][0]}', took_s, COMMAND_S[name], 's')
    if spoke:
        told('first message of the slowest node', max(spoke.values()), NODE_S, 's')
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
