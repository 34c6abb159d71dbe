# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A camera of Kalibr's camchain: pinhole-radtan or pinhole-equi."""

from __future__ import annotations

from typing import Any

from starcal_ros.messages import topics
from starcal_ros.results.camera_files.foreign_camera import ForeignCamera

_MODELS = {'plumb_bob': 'radtan', 'equidistant': 'equidistant', 'kannala_brandt': 'equidistant'}
_COUNT = 4              # coefficients of either


def camera(of: ForeignCamera) -> dict[str, Any] | None:
    """Return the entry of a camera; None of a lens that Kalibr has not."""
    if of.lens not in _MODELS:
        return None
    return {'camera_model': 'pinhole', 'distortion_model': _MODELS[of.lens],
            'distortion_coeffs': [*of.coefficients, *(0.0,) * (_COUNT - len(of.coefficients))],
            'intrinsics': [of.f_px, of.f_px, *of.centre_px],
            'resolution': [of.width, of.height], 'rostopic': topics.IMAGES.recorded}
