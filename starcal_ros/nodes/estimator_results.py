# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the estimator publishes: an attitude for each gyro reading, its results for each frame."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray

from starcal_ros.filter.attitude_track import AttitudeTrack
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.frame_result import FrameResult
from starcal_ros.messages import cdr_imu, topics
from starcal_ros.messages.conventions import CALIBRATED_FRAME, GYRO_FRAME
from starcal_ros.nodes.base.managed_node import ManagedNode
from starcal_ros.nodes.base.qos import message_type
from starcal_ros.nodes.base.rhythm import Rhythm
from starcal_ros.nodes.base.ros_messages import CONTENTS


class Results:
    """The publishers of the estimator, as those of a managed node.

    Attributes
    ----------
    rhythm : Rhythm
        To be told of the readings that come.
    """

    def __init__(self, node: ManagedNode) -> None:
        self.rhythm = Rhythm(node.scenario.gyro.rate_hz)
        self._attitude = node.offer(topics.ATTITUDE)
        self._state = node.offer(topics.STATE)
        self._camera = node.offer(topics.CAMERA)
        self._bias = node.offer(topics.GYRO_BIAS)
        self._mounting = node.offer(topics.MOUNTING)
        self._residuals = node.offer(topics.RESIDUALS)
        # tf2_msgs is not among PyPI's packages of ROS 2; every distribution has it.
        self._transforms = message_type(topics.TRANSFORM.type_name)
        self._transform = self._transforms and node.offer(topics.TRANSFORM)
        self._diagnostics = node.offer(topics.DIAGNOSTICS)

    def publish_track(self, calibrator: Calibrator, track: AttitudeTrack) -> None:
        """Publish the attitude and the rate at gyro stamps."""
        for row in self.rhythm.spread(cdr_imu.encode_attitudes(
                track, calibrator.rate_covariance, GYRO_FRAME)):
            self._attitude.publish(row.tobytes())

    def publish_frame(self, calibrator: Calibrator, frame: FrameResult) -> None:
        """Publish what a frame gave."""
        stamp_ns, belief = frame.stamp_ns, frame.belief
        estimate, covariance = belief.estimate, belief.covariance
        self._state.publish(CONTENTS.state(stamp_ns, belief))
        self._camera.publish(CONTENTS.camera_info(
            stamp_ns, estimate.intrinsics, calibrator.filter.detector, CALIBRATED_FRAME))
        self._bias.publish(CONTENTS.gyro_bias(stamp_ns, estimate.bias, covariance))
        self._mounting.publish(CONTENTS.mounting(stamp_ns, estimate.C_sg, covariance))
        if self._transform:
            self._transform.publish(self._transforms(
                transforms=CONTENTS.transforms(stamp_ns, estimate.C_sg)))
        self._residuals.publish(CONTENTS.residuals(frame))

    def publish_diagnostics(self, message: DiagnosticArray) -> None:
        """Publish how the estimator is."""
        self._diagnostics.publish(message)
