# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the estimator publishes: an attitude for each gyro reading, its results for each frame."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2
from std_msgs.msg import Float64MultiArray

from starcal_ros.filter.attitude_track import AttitudeTrack
from starcal_ros.filter.calibrator import Calibrator, FrameResult
from starcal_ros.messages import topics
from starcal_ros.nodes.base import ros_messages
from starcal_ros.nodes.base.flow_publisher import PATIENCE_S, FlowPublisher, drain

try:
    from tf2_msgs.msg import TFMessage
except ImportError:             # not among PyPI's packages of ROS 2; every distribution has it
    TFMessage = None

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
        self._imu = self._publisher(Imu, topics.ATTITUDE.name, latched=False)
        self._state = self._publisher(Float64MultiArray, topics.STATE.name)
        self._camera = self._publisher(CameraInfo, topics.CAMERA.name)
        self._bias = self._publisher(TwistWithCovarianceStamped, topics.GYRO_BIAS.name)
        self._mounting = self._publisher(PoseWithCovarianceStamped, topics.MOUNTING.name)
        self._residuals = self._publisher(PointCloud2, topics.RESIDUALS.name)
        self._transform = TFMessage and self._publisher(TFMessage, topics.TRANSFORM.name)
        self._diagnostics = self._publisher(DiagnosticArray, topics.DIAGNOSTICS.name,
                                            latched=False)

    def _publisher(self, kind: type, topic: str, latched: bool = True) -> FlowPublisher:
        publisher = FlowPublisher(self._node, kind, topic, latched=latched,
                                  patience_s=PATIENCE_S)
        self.publishers.append(publisher)
        return publisher

    def publish_track(self, calibrator: Calibrator, track: AttitudeTrack) -> None:
        """Publish the attitude and the rate at gyro stamps."""
        for message in ros_messages.imus(track, calibrator.rate_covariance):
            self._imu.publish(message)

    def publish_frame(self, calibrator: Calibrator, frame: FrameResult) -> None:
        """Publish what a frame gave."""
        stamp_ns, belief = frame.stamp_ns, frame.belief
        covariance = belief.covariance
        self._state.publish(ros_messages.state(stamp_ns, belief))
        self._camera.publish(ros_messages.camera_info(
            stamp_ns, belief.estimate.intrinsics, calibrator.filter.detector))
        self._bias.publish(ros_messages.gyro_bias(stamp_ns, belief, covariance))
        self._mounting.publish(ros_messages.mounting(stamp_ns, belief, covariance))
        if self._transform:
            self._transform.publish(TFMessage(
                transforms=[ros_messages.mounting_transform(stamp_ns, belief)]))
        self._residuals.publish(ros_messages.residuals(frame))

    def publish_diagnostics(self, message: DiagnosticArray) -> None:
        """Publish how the estimator is."""
        self._diagnostics.publish(message)

    def destroy(self) -> None:
        """End the publishers when all is delivered, or after some seconds."""
        drain(self.publishers, _DRAIN_S)
        for publisher in self.publishers:
            publisher.destroy()
