# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a recorder that is killed has lost, in stamps, at several speeds.

::

    python bench/kill.py --out docs/reliability/kill.json

Gyro readings of 100 Hz and star frames of 2 Hz are played; at some moment the recorder gets
SIGKILL. The newest stamp that another subscriber has by then, less the newest in the file, is
what was lost. Beyond a factor of 20, and on a busy machine, the other subscriber may be the one
that is behind: then nothing is written, and the exit status is 1.
"""

import argparse
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import Imu, PointCloud2

from starcal_ros.config import parameter_file
from starcal_ros.config.shipped import config_file
from starcal_ros.recording.mcap_tail import McapTail
from starcal_ros.simulation.write_recording import simulate
from starcal_ros.workflows.live_run import isolated
from starcal_ros.workflows.node_program import node_command

FACTORS, REPEATS, DURATION_S = (1.0, 5.0, 10.0, 20.0), 5, 300.0


def lost_s(node: Node, bag: Path, factor: float, after_s: float) -> float:
    """Return what is lost in one run [s]."""
    newest_ns = 0

    def take(message: Imu) -> None:
        nonlocal newest_ns
        newest_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec

    with tempfile.TemporaryDirectory() as name:
        path = Path(name, 'run.mcap')
        recorder = subprocess.Popen(node_command('recorder', {'recorder.output': path}),
                                    stderr=subprocess.PIPE, text=True)
        assert any('recording to' in line for line in recorder.stderr or ())
        subscriptions = [node.create_subscription(
            Imu, 'imu/data_raw', take, QoSProfile(history=HistoryPolicy.KEEP_ALL)),
            node.create_subscription(
                PointCloud2, 'star_tracker/centroids', lambda message: None, 10)]
        player = subprocess.Popen(node_command('player', {
            'player.bag': bag, 'player.rate': factor, 'player.wait_for_subscribers': 2}),
            stderr=subprocess.DEVNULL)
        try:
            while not newest_ns:
                rclpy.spin_once(node, timeout_sec=0.1)
            ends = time.monotonic() + after_s
            while time.monotonic() < ends:
                rclpy.spin_once(node, timeout_sec=0.01)
        finally:
            recorder.kill()
            recorder.wait()
            player.send_signal(signal.SIGINT)
            player.wait()
            for subscription in subscriptions:
                node.destroy_subscription(subscription)
        return (newest_ns - McapTail(path).newest_ns()) * 1e-9


def main() -> int:
    """Write what was lost at each factor."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--out', type=Path, help='JSON file to write; else it is printed')
    options = parser.parse_args()
    runs = []
    os.environ.update(isolated())
    rclpy.init()
    node, rng = rclpy.create_node('witness'), np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as name:
        bag = Path(name, 'bag.mcap')
        simulate(parameter_file.load(config_file('tan2018.yaml')).replace(
            {'simulation.duration_s': DURATION_S}), bag)
        for factor in FACTORS:
            lost = [lost_s(node, bag, factor, rng.uniform(2.0, 4.0)) for _ in range(REPEATS)]
            if min(lost) < 0.0:
                print(f'at a factor of {factor:g} the file was ahead of the other subscriber by '
                      f'{-min(lost):.2f} s: that says nothing', file=sys.stderr)
                return 1
            runs.append({'factor': factor, 'median_s': round(float(np.median(lost)), 3),
                         'most_s': round(max(lost), 3)})
    rclpy.shutdown()
    text = json.dumps({'repeats': REPEATS, 'runs': runs}, indent=1) + '\n'
    if options.out:
        options.out.write_text(text)
    else:
        print(text, end='')
    return 0


if __name__ == '__main__':
    sys.exit(main())
