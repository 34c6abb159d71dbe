# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the estimator publishes: an attitude for each gyro reading, its results for each frame."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from starcal_ros.filter.attitude_track import AttitudeTrack
from starcal_ros.filter.calibrator import Calibrator, FrameResult
from starcal_ros.messages import cdr_imu, topics
from starcal_ros.messages.conventions import GYRO_FRAME
from starcal_ros.messages.topics import Topic
from starcal_ros.nodes.base.flow_publisher import PATIENCE_S, FlowPublisher, drain
from starcal_ros.nodes.base.qos import message_type
from starcal_ros.nodes.base.ros_messages import CONTENTS

_DRAIN_S = 6.0          # for the last results; acknowledgements may take 3 s


class Results:
    """The publishers of the estimator.

    Attributes
    ----------
    publishers : list of FlowPublisher
        All of them.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.publishers: list[FlowPublisher] = []
        self._attitude = self._publisher(topics.ATTITUDE)
        self._state = self._publisher(topics.STATE)
        self._camera = self._publisher(topics.CAMERA)
        self._bias = self._publisher(topics.GYRO_BIAS)
        self._mounting = self._publisher(topics.MOUNTING)
        self._residuals = self._publisher(topics.RESIDUALS)
        # tf2_msgs is not among PyPI's packages of ROS 2; every distribution has it.
        self._transforms = message_type(topics.TRANSFORM.type_name)
        self._transform = self._transforms and self._publisher(topics.TRANSFORM)
        self._diagnostics = self._publisher(topics.DIAGNOSTICS)

    def _publisher(self, topic: Topic) -> FlowPublisher:
        publisher = FlowPublisher(self._node, message_type(topic.type_name), topic.name,
                                  latched=topic.latched, patience_s=PATIENCE_S)
        self.publishers.append(publisher)
        return publisher

    def publish_track(self, calibrator: Calibrator, track: AttitudeTrack) -> None:
        """Publish the attitude and the rate at gyro stamps."""
        for row in cdr_imu.encode_attitudes(track, calibrator.rate_covariance, GYRO_FRAME):
            self._attitude.publish(row.tobytes())

    def publish_frame(self, calibrator: Calibrator, frame: FrameResult) -> None:
        """Publish what a frame gave."""
        stamp_ns, belief = frame.stamp_ns, frame.belief
        estimate, covariance = belief.estimate, belief.covariance
        self._state.publish(CONTENTS.state(stamp_ns, belief))
        self._camera.publish(CONTENTS.camera_info(
            stamp_ns, estimate.intrinsics, calibrator.filter.detector))
        self._bias.publish(CONTENTS.gyro_bias(stamp_ns, estimate.bias, covariance))
        self._mounting.publish(CONTENTS.mounting(stamp_ns, estimate.C_sg, covariance))
        if self._transform:
            self._transform.publish(self._transforms(
                transforms=[CONTENTS.transform(stamp_ns, estimate.C_sg)]))
        self._residuals.publish(CONTENTS.residuals(frame))

    def publish_diagnostics(self, message: DiagnosticArray) -> None:
        """Publish how the estimator is."""
        self._diagnostics.publish(message)

    def destroy(self) -> None:
        """End the publishers when all is delivered, or after some seconds."""
        drain(self.publishers, _DRAIN_S)
        for publisher in self.publishers:
            publisher.destroy()
