# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `intrinsics_estimator`: star centroids in, the camera out, by any method, no attitude.

It asks its method for the camera once a second, or less often where the answer takes long, and
once more at the end.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

from starcal_ros import calibration
from starcal_ros.config.models import detector
from starcal_ros.messages import cdr_imu, cdr_pointcloud, topics
from starcal_ros.messages.conventions import INTRINSICS_FRAME
from starcal_ros.nodes import intrinsics_diagnostics
from starcal_ros.nodes.base import run_loop
from starcal_ros.nodes.base.decoding import decoded
from starcal_ros.nodes.base.managed_node import ManagedNode
from starcal_ros.nodes.base.ros_messages import CONTENTS

_PERIOD_S = 1.0
_SHARE = 0.2            # of the time that may go into answers
_STARS = 3000           # that the verdict of an answer looks at, at most


class IntrinsicsEstimator(ManagedNode):
    """Feed a `CameraMethod` from two topics and publish its camera and the verdict on it."""

    def __init__(self, **options: Any) -> None:
        super().__init__('intrinsics_estimator', 'camera', 'mounting', 'gyro', 'star_tracker',
                         'observer', 'estimator', 'intrinsics', **options)
        self.start()

    def configure(self) -> None:
        """Prepare the calibration and its publishers."""
        self._method = calibration.start(self.scenario)
        self._detector = detector(self.scenario.camera)
        self._dirty, self._not_before = False, 0.0
        self._camera = self.offer(topics.INTRINSICS_CAMERA)
        self._state = self.offer(topics.INTRINSICS_STATE)
        self._diagnostics = self.offer(topics.DIAGNOSTICS)

    def activate(self) -> None:
        """Listen to the sensors."""
        self.listen(topics.IMU, self._on_gyro)
        self.listen(topics.CENTROIDS, self._on_frames)
        self.repeat(_PERIOD_S, self._answer_in_time)

    def deactivate(self) -> None:
        """Give the last answer."""
        self._answer()

    def _on_gyro(self, batch: list[bytes]) -> None:
        for part in decoded(batch, cdr_imu.decode_imu, self.faults.alike):
            self._method.add_gyro(part)

    def _on_frames(self, batch: list[bytes]) -> None:
        for part in decoded(batch, cdr_pointcloud.decode_centroids, self.faults.alike):
            self._method.add_frames(part)
            self._dirty = True

    def _answer_in_time(self) -> None:
        if perf_counter() >= self._not_before:
            self._answer()

    def _answer(self) -> None:
        if not self._dirty:
            return
        self._dirty, begun = False, perf_counter()
        estimate = self._method.estimate()
        for text in self._method.take_notices():
            self.get_logger().warning(text)
        judged = None if estimate is None else self._method.judge(estimate, _STARS)
        stamp_ns = self._method.stamp_ns
        self._diagnostics.publish(
            intrinsics_diagnostics.message(self, estimate, judged, stamp_ns))
        if estimate is not None:
            self._camera.publish(CONTENTS.camera_info(
                stamp_ns, estimate.intrinsics, self._detector, INTRINSICS_FRAME))
            self._state.publish(CONTENTS.intrinsics(stamp_ns, estimate))
        ended = perf_counter()
        self._not_before = ended + (ended - begun) * (1.0 / _SHARE - 1.0)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(IntrinsicsEstimator, args)
