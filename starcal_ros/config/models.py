# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""From parameters to the objects of the core: detector, intrinsics, mounting, observer."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.scenario import CameraConfig, MountingConfig, ObserverConfig
from starcal_ros.config.truth import TrueCameraConfig, TrueObserverConfig
from starcal_ros.core import rotation
from starcal_ros.core.camera import Detector
from starcal_ros.sky.apparent import Observer

Array = NDArray[np.float64]


def detector(camera: CameraConfig) -> Detector:
    """Return the pixels of a camera."""
    return Detector(camera.width, camera.height, camera.pixel_pitch_mm)


def intrinsics(camera: CameraConfig, instead: TrueCameraConfig | None = None) -> Array:
    """Return the intrinsics, (7,); what `instead` states replaces the nominal values."""
    values = []
    for name in ('principal_point_px', 'focal_length_mm', 'distortion'):
        value = getattr(instead, name, None)
        values.append(getattr(camera, name) if value is None else value)
    return np.hstack(values).astype(float)


def mounting_matrix(mounting: MountingConfig) -> Array:
    """Return C_sg, (3, 3); the identity where the mounting is not stated."""
    if mounting.quaternion_xyzw is not None:
        q = np.array(mounting.quaternion_xyzw)
        return rotation.to_matrix(q / np.linalg.norm(q))
    return rotation.from_fixed_angles(np.radians(mounting.fixed_angles_deg or (0.0, 0.0, 0.0)))


def observer(config: ObserverConfig, instead: TrueObserverConfig | None = None) -> Observer:
    """Return who looks at the sky; what `instead` states replaces the nominal values."""
    values = {}
    for item in dataclasses.fields(config):
        value = getattr(instead, item.name, None)
        values[item.name] = getattr(config, item.name) if value is None else value
    return Observer(**values)
