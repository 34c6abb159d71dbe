#!/usr/bin/env python3
# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Wait until the calibration may be trusted, then print the camera: an example subscriber.

    python examples/trusted_camera.py [--ros-args -r __ns:=/my_namespace]

It says what is still missing whenever that changes. The camera is a CameraInfo as any other: it
can be handed to image_geometry, OpenCV or an image pipeline as it is.
"""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import CameraInfo

# Results are latched: whoever comes late gets the last one at once.
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class TrustedCamera(Node):
    """Listen to the camera and to the verdict on it."""

    def __init__(self) -> None:
        super().__init__('trusted_camera')
        self.trusted = Future()
        self._camera: CameraInfo | None = None
        self._verdict = ''
        self.create_subscription(CameraInfo, 'starcal/camera_info', self._on_camera, LATCHED)
        self.create_subscription(DiagnosticArray, 'diagnostics', self._on_diagnostics, 10)

    def _on_camera(self, camera: CameraInfo) -> None:
        self._camera = camera

    def _on_diagnostics(self, diagnostics: DiagnosticArray) -> None:
        for status in diagnostics.status:
            if status.name.endswith('starcal: calibration'):
                self._on_verdict(status)

    def _on_verdict(self, status: DiagnosticStatus) -> None:
        if status.message != self._verdict:
            self._verdict = status.message
            print(status.message, flush=True)
        if self._verdict == 'converged' and self._camera and not self.trusted.done():
            self.trusted.set_result(self._camera)


def main() -> None:
    """Run the node until there is a camera."""
    rclpy.init()
    node = TrustedCamera()
    try:
        rclpy.spin_until_future_complete(node, node.trusted)
    except KeyboardInterrupt:
        return
    camera = node.trusted.result()
    if camera:
        print(f'fx fy [px]  {camera.k[0]:.3f} {camera.k[4]:.3f}')
        print(f'cx cy [px]  {camera.k[2]:.3f} {camera.k[5]:.3f}')
        print('distortion ', ' '.join(f'{value:.6f}' for value in camera.d))
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
