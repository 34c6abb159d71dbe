# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A calibrated camera and its covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from starcal_ros.core.arrays import Array


@dataclass(frozen=True)
class CameraEstimate:
    """A calibrated camera.

    Attributes
    ----------
    intrinsics : (7,) array
        As in `starcal_ros.core.camera`.
    covariance : (7, 7) array
        Of their errors; zero where an intrinsic was not estimated.
    frames, stars : int
        Used so far.
    """

    intrinsics: Array
    covariance: Array
    frames: int
    stars: int

    @property
    def sigma(self) -> Array:
        """Standard deviations, (7,)."""
        return np.sqrt(np.diag(self.covariance))
