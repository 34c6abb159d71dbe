# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a method that calibrates the camera alone is."""

from __future__ import annotations

from typing import Protocol

from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.measurements.samples import Frames, GyroSamples


class CameraMethod(Protocol):
    """A calibration in progress; ``start`` of each calibration method makes one."""

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take gyro samples with increasing stamps."""

    def add_frames(self, frames: Frames) -> None:
        """Take frames with increasing stamps."""

    def estimate(self) -> CameraEstimate | None:
        """Return the camera from all that has come so far; None while there is nothing to say."""

    def take_notices(self) -> list[str]:
        """Return what happened that a user should know, once."""
