# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `star_tracker_sim`: publishes simulated star centroids, nominal camera and truth.

With ``simulation.images`` it publishes images too, and the centroids as truth: who extracts and
identifies the stars then has the topic `star_tracker/centroids` to himself.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from geometry_msgs.msg import QuaternionStamped
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Float64MultiArray

from starcal_ros.config.models import detector, intrinsics
from starcal_ros.config.parameter import ConfigError
from starcal_ros.messages import cdr_image, cdr_imu, cdr_pointcloud, topics
from starcal_ros.messages.conventions import INERTIAL_FRAME, OPTICAL_FRAME
from starcal_ros.nodes.base import parameters, run_loop
from starcal_ros.nodes.base.flow_publisher import FlowPublisher
from starcal_ros.nodes.base.pacing import Item
from starcal_ros.nodes.base.ros_messages import CONTENTS
from starcal_ros.nodes.base.simulator import Simulator
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import VECTOR_LABEL

_BATCH = 20


class StarTrackerSim(Simulator):
    """Publish the frames of a scenario, its nominal camera and its truth."""

    def __init__(self, **options: Any) -> None:
        super().__init__('star_tracker_sim', **options)
        scenario = parameters.declare(self, 'camera', 'mounting', 'gyro', 'star_tracker',
                                      'image', 'motion', 'observer', 'truth', 'simulation')
        try:
            self._simulator = sensors.star_tracker(scenario)
            self._renderer = sensors.images(scenario) if scenario.simulation.images else None
        except ValueError as error:         # a catalogue that does not reach so deep
            raise ConfigError(str(error)) from None
        self._truth = self._simulator.truth
        # The topic that the run waits for comes last: who listens to it has found the others.
        info = FlowPublisher(self, CameraInfo, topics.NOMINAL_CAMERA.name, latched=True)
        truth = FlowPublisher(self, Float64MultiArray, topics.TRUE_PARAMETERS.name, latched=True)
        self._attitude = FlowPublisher(self, QuaternionStamped, topics.TRUE_ATTITUDE.name)
        self._centroids = FlowPublisher(
            self, PointCloud2,
            (topics.TRUE_CENTROIDS if self._renderer else topics.CENTROIDS).name)
        self._images = (FlowPublisher(self, Image, topics.IMAGES.name)
                        if self._renderer else None)
        info.publish(CONTENTS.camera_info(
            self._truth.motion.start_ns, intrinsics(scenario.camera), detector(scenario.camera),
            OPTICAL_FRAME))
        values = self._truth.vector()
        truth.publish(CONTENTS.labelled([(VECTOR_LABEL, len(values))], values))
        self.begin(scenario.simulation, self._images or self._centroids, self._items())

    def _items(self) -> Iterator[Item]:
        while len(frames := self._simulator.next(_BATCH)):
            attitudes = cdr_imu.encode_quaternions(
                frames.stamp_ns, self._truth.motion.attitude(frames.stamp_ns), INERTIAL_FRAME)
            for stamp_ns, attitude, message in zip(frames.stamp_ns.tolist(), attitudes,
                                                   cdr_pointcloud.encode_centroids(frames)):
                if self._renderer and self._images:
                    yield stamp_ns, self._images, cdr_image.encode_image(
                        stamp_ns, self._renderer.image(stamp_ns))
                yield stamp_ns, self._centroids, message
                yield stamp_ns, self._attitude, attitude.tobytes()


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(StarTrackerSim, args)
