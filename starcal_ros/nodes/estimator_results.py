# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the estimator publishes: an attitude for each gyro reading, its results for each frame."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray

from starcal_ros.filter.attitude_track import AttitudeTrack
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.frame_result import FrameResult
from starcal_ros.messages import cdr_imu, cdr_results, topics
from starcal_ros.messages.conventions import GYRO_FRAME
from starcal_ros.nodes.base.managed_node import ManagedNode
from starcal_ros.nodes.base.qos import message_type
from starcal_ros.nodes.base.rhythm import Rhythm


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
        self._transform = (node.offer(topics.TRANSFORM)
                           if message_type(topics.TRANSFORM.type_name) else None)
        self._diagnostics = node.offer(topics.DIAGNOSTICS)

    def publish_track(self, calibrator: Calibrator, track: AttitudeTrack) -> None:
        """Publish the attitude and the rate at gyro stamps."""
        if len(track.stamp_ns):
            for row in self.rhythm.spread(cdr_imu.encode_attitudes(
                    track, calibrator.rate_covariance, GYRO_FRAME)):
                self._attitude.publish(row.tobytes())

    def publish_frame(self, calibrator: Calibrator, frame: FrameResult) -> None:
        """Publish what a frame gave: the state first, which is waited for."""
        stamp_ns, belief = frame.stamp_ns, frame.belief
        self._state.publish(cdr_results.encode_state(stamp_ns, belief))
        self.publish_track(calibrator, frame.track)
        estimate, covariance = belief.estimate, belief.covariance
        self._camera.publish(cdr_results.encode_camera(
            stamp_ns, estimate.intrinsics, calibrator.filter.detector))
        self._bias.publish(cdr_results.encode_bias(stamp_ns, estimate.bias, covariance))
        self._mounting.publish(cdr_results.encode_mounting(stamp_ns, estimate.C_sg, covariance))
        if self._transform:
            self._transform.publish(cdr_results.encode_transforms(stamp_ns, estimate.C_sg))
        self._residuals.publish(cdr_results.encode_residuals(frame))

    def publish_diagnostics(self, message: DiagnosticArray) -> None:
        """Publish how the estimator is."""
        self._diagnostics.publish(message)
