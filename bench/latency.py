# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How long the estimator takes from a star frame to its state: `python bench/latency.py`.

Simulators, estimator and recorder at real time, four processes. This one listens, too: for each
frame it takes the time from when it had the frame and a gyro reading not before it, which the
estimator waits for, to when it had the state, and the residuals, which are published last. The
frames of the first half minute do not count.
"""

from __future__ import annotations

import os
from pathlib import Path
import signal
import sys
import tempfile
import time

from bars import told
from live import NODES, start
import numpy as np

from starcal_ros.config import parameter_file
from starcal_ros.config.shipped import config_file
from starcal_ros.workflows import live_run

DURATION_S, SETTLE_S = 120.0, 30.0
ALLOWED_MS = 10.0           # 99th percentile, of the state


def listen() -> dict[str, dict[int, float]]:
    """Return when each stamp of a topic [us] was heard first, up to the end of the simulation."""
    import rclpy
    from rclpy.qos import HistoryPolicy, QoSProfile
    from sensor_msgs.msg import Imu, PointCloud2
    from std_msgs.msg import Float64MultiArray

    from starcal_ros.nodes.base.stamps import stamp_reader
    rclpy.init()
    node = rclpy.create_node('latency')
    heard: dict[str, dict[int, float]] = {}

    def note(topic: str, stamp_ns: int | None, now_s: float) -> None:
        heard[topic].setdefault(round((stamp_ns or 0) * 1e-3), now_s)
    for topic, kind in (('imu/data_raw', Imu), ('star_tracker/centroids', PointCloud2),
                        ('starcal/state', Float64MultiArray),
                        ('starcal/residuals', PointCloud2)):
        heard[topic] = {}
        node.create_subscription(
            kind, topic, lambda message, topic=topic, stamp_ns=stamp_reader(kind): note(
                topic, stamp_ns(message), time.monotonic()),
            QoSProfile(history=HistoryPolicy.KEEP_ALL), raw=True)
    quiet_since = time.monotonic() + 20.0       # they may take their time to begin
    count = 0
    while time.monotonic() - quiet_since < 10.0:
        rclpy.spin_once(node, timeout_sec=1.0)
        if (now := sum(map(len, heard.values()))) > count:
            count, quiet_since = now, time.monotonic()
    node.destroy_node()
    rclpy.try_shutdown()
    return heard


def main() -> int:
    """Print the percentiles."""
    scenario = parameter_file.load(config_file('tan2018.yaml')).replace({
        'simulation.duration_s': DURATION_S, 'simulation.real_time_factor': 1.0,
        'estimator.wait_for_subscribers': 1, 'simulation.wait_for_subscribers': 3,
        'simulation.wait_for_simulators': 1})
    os.environ.update(live_run.isolated())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / 'config.yaml').write_text(parameter_file.dump(scenario.replace({
            'recorder.output': str(folder / 'run.mcap')})))
        nodes = [start(each, folder) for each in NODES]
        try:
            readings, frames, states, residuals = listen().values()
        finally:
            for node in reversed(nodes):
                node.send_signal(signal.SIGINT)
                node.communicate()
    stamps = np.array(sorted(readings))
    most = {}
    for name, results in (('state', states), ('residuals', residuals)):
        late = []
        for stamp_us in sorted(frames)[round(SETTLE_S * scenario.star_tracker.rate_hz):]:
            place = int(np.searchsorted(stamps, stamp_us))
            if stamp_us in results and place < len(stamps):
                ready = max(frames[stamp_us], readings[int(stamps[place])])
                late.append(1e3 * (results[stamp_us] - ready))
        middle, most[name] = np.percentile(late, [50.0, 99.0])
        print(f'{name}: {len(late)} frames, median {middle:.1f} ms, 99th percentile '
              f'{most[name]:.1f} ms')
    return 0 if told('frame to published state, 99th percentile', most['state'], ALLOWED_MS,
                     'ms') else 1


if __name__ == '__main__':
    sys.exit(main())
