# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `gyro_sim`: publishes simulated gyro readings on imu/data_raw."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sensor_msgs.msg import Imu

from starcal_ros.messages import cdr_imu, topics
from starcal_ros.messages.conventions import GYRO_FRAME
from starcal_ros.nodes.base import parameters, run_loop
from starcal_ros.nodes.base.flow_publisher import FlowPublisher
from starcal_ros.nodes.base.pacing import Item
from starcal_ros.nodes.base.simulator import Simulator
from starcal_ros.simulation import sensors

_BATCH = 100


class GyroSim(Simulator):
    """Publish the readings of a scenario."""

    def __init__(self, **options: Any) -> None:
        super().__init__('gyro_sim', **options)
        scenario = parameters.declare(self, 'gyro', 'motion', 'truth', 'simulation')
        self._simulator = sensors.gyro(scenario)
        self._told = 0
        self._readings = FlowPublisher(self, Imu, topics.IMU.name)
        self.begin(scenario.simulation, self._readings, self._items())

    def _items(self) -> Iterator[Item]:
        while len(samples := self._simulator.next(_BATCH)):
            part = 100 * self._simulator.next_index // self._simulator.count
            if part > self._told:
                self._told = part
                self.get_logger().info(f'{part} %')
            messages = cdr_imu.encode_imu(samples, GYRO_FRAME, self._simulator.rate_variance)
            for stamp_ns, message in zip(samples.stamp_ns.tolist(), messages):
                yield stamp_ns, self._readings, message.tobytes()


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(GyroSim, args)
