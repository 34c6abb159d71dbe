# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A camera as ROS has it: the file of camera_info_manager, with what sensor_msgs names models."""

from __future__ import annotations

from typing import Any

import numpy as np

from starcal_ros.results.camera_files.foreign_camera import ForeignCamera

CAMERA_NAME = 'star_tracker'
_MODELS = {'plumb_bob': ('plumb_bob', 5), 'rational': ('rational_polynomial', 8),
           'equidistant': ('equidistant', 4), 'kannala_brandt': ('equidistant', 4)}
"""Its model and number of coefficients of each lens that it has."""


def camera_info(camera: ForeignCamera) -> dict[str, Any] | None:
    """Return the content of the file; None of a lens that sensor_msgs has no name for."""
    if camera.lens not in _MODELS:
        return None
    model, count = _MODELS[camera.lens]
    f, (cu, cv) = camera.f_px, camera.centre_px
    coefficients = (*camera.coefficients, *(0.0,) * (count - len(camera.coefficients)))

    def matrix(rows: int, data: list[float]) -> dict[str, Any]:
        return {'rows': rows, 'cols': len(data) // rows, 'data': data}
    return {'image_width': camera.width, 'image_height': camera.height,
            'camera_name': CAMERA_NAME,
            'camera_matrix': matrix(3, [f, 0.0, cu, 0.0, f, cv, 0.0, 0.0, 1.0]),
            'distortion_model': model, 'distortion_coefficients': matrix(1, list(coefficients)),
            'rectification_matrix': matrix(3, np.eye(3).ravel().tolist()),
            'projection_matrix': matrix(3, [f, 0.0, cu, 0.0, 0.0, f, cv, 0.0, 0.0, 0.0, 1.0,
                                            0.0])}
