# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A calibrated camera in OpenCV's terms, which other programs share."""

from __future__ import annotations

from typing import NamedTuple

from starcal_ros.core import lenses
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import Detector
from starcal_ros.messages.conventions import camera_info


class ForeignCamera(NamedTuple):
    """Pixels, focal length, principal point and distortion.

    Attributes
    ----------
    lens : str
        Lens model, one of `lenses.NAMES`.
    width, height : int
        Pixels.
    f_px : float
        Focal length, the same in both axes [px].
    centre_px : (float, float)
        Principal point; (0, 0) is the centre of the top-left pixel [px].
    coefficients : tuple of float
        OpenCV's, in its order.
    """

    lens: str
    width: int
    height: int
    f_px: float
    centre_px: tuple[float, float]
    coefficients: tuple[float, ...]

    @classmethod
    def of_intrinsics(cls, intrinsics: Array, detector: Detector) -> ForeignCamera:
        """Return the camera of T18 with intrinsics (7,)."""
        info = camera_info(intrinsics, detector)
        return cls(lenses.PLUMB_BOB, detector.width, detector.height, info.K[0],
                   (info.K[2], info.K[5]), tuple(info.D[:4]))
