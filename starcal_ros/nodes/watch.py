# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `watch`: the running estimator in the terminal, as `starcal_ros.report.watch` draws it.

It subscribes to results alone, never to a sensor, and keeps the newest message of each: nobody
waits for it. On a terminal it redraws twice a second; where it writes into a file or a pipe,
it writes the last view, when it ends.
"""

from __future__ import annotations

import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from numpy.typing import NDArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rich.console import Console, RenderableType
from rich.live import Live
from sensor_msgs.msg import CameraInfo, PointCloud2, PointField
from std_msgs.msg import Float64MultiArray

from starcal_ros.messages import topics
from starcal_ros.nodes.base import run_loop
from starcal_ros.nodes.base.parameters import AnsweringNode
from starcal_ros.report.watch import STAR_FIELDS, STATE_SIZE, Seen, render

_DRAW_S = 0.5
_PIPE_COLUMNS = 100
_LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                      durability=DurabilityPolicy.TRANSIENT_LOCAL)
_PASSING = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
_KINDS = {PointField.FLOAT64: 'f8', PointField.FLOAT32: 'f4', PointField.UINT32: 'u4',
          PointField.UINT8: 'u1'}


class Watch(AnsweringNode):
    """Draw what the estimator says."""

    def __init__(self, **options: Any) -> None:
        super().__init__('watch', **options)
        self._seen, self._heard_s = Seen(), -np.inf
        for kind, topic, take, qos in (
                (Float64MultiArray, topics.STATE.name, self._take_state, _LATCHED),
                (PointCloud2, topics.RESIDUALS.name, self._take_stars, _LATCHED),
                (CameraInfo, topics.CAMERA.name, self._take_camera, _LATCHED),
                (DiagnosticArray, topics.DIAGNOSTICS.name, self._take_diagnostics, _PASSING)):
            self.create_subscription(kind, topic, take, qos)
        self._console = Console()
        if not self._console.is_terminal:
            self._console = Console(width=_PIPE_COLUMNS)
        self._live = Live(console=self._console, screen=self._console.is_terminal,
                          auto_refresh=False)
        if self._console.is_terminal:
            self._live.start()
            run_loop.steady_timer(self, _DRAW_S, self._draw)

    def close(self) -> None:
        """Leave the last view on the terminal."""
        self._live.stop()
        self._console.print(self._view())

    def _view(self) -> RenderableType:
        self._seen.silent_s = time.monotonic() - self._heard_s
        return render(self._seen)

    def _draw(self) -> None:
        self._live.update(self._view(), refresh=True)

    def _take_state(self, message: Float64MultiArray) -> None:
        if len(message.data) == STATE_SIZE:
            self._seen.state = np.array(message.data)

    def _take_stars(self, message: PointCloud2) -> None:
        if {*STAR_FIELDS} <= {item.name for item in message.fields}:
            self._seen.stars = points(message)

    def _take_camera(self, message: CameraInfo) -> None:
        self._seen.size = message.width, message.height

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            if status.name.endswith('starcal: calibration'):
                self._heard_s = time.monotonic()
                self._seen.level, self._seen.message = status.level[0], status.message
                self._seen.values = values
            elif status.name.endswith('starcal: inputs'):
                self._seen.inputs_message, self._seen.inputs = status.message, values


def points(cloud: PointCloud2) -> NDArray[np.void]:
    """Return the points of a cloud, by the names of its fields."""
    order = '>' if cloud.is_bigendian else '<'
    kind = np.dtype({'names': [item.name for item in cloud.fields],
                     'formats': [order + _KINDS[item.datatype] for item in cloud.fields],
                     'offsets': [item.offset for item in cloud.fields],
                     'itemsize': cloud.point_step})
    return np.frombuffer(cloud.data, kind, cloud.width * cloud.height)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(Watch, args)
