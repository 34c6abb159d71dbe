# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a method that calibrates the camera alone is, and what it gives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.models import intrinsics
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.camera import INTRINSICS
from starcal_ros.measurements.samples import Frames, GyroSamples

Array = NDArray[np.float64]


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


def beginning(scenario: Scenario, known: CameraEstimate | None = None) -> CameraEstimate:
    """Return where a method begins: what is known, or the nominal camera and its initial sigmas.

    Intrinsics that ``intrinsics.estimate`` does not list are taken for certain.
    """
    if known is None:
        sigma = scenario.estimator.initial_sigma
        covariance = np.diag(np.square([
            sigma.principal_point_px, sigma.principal_point_px, sigma.focal_length_mm, sigma.k1,
            sigma.k2, sigma.p1, sigma.p2]))
        known = CameraEstimate(intrinsics(scenario.camera), covariance, 0, 0)
    free = np.isin(INTRINSICS, scenario.intrinsics.estimate)
    return replace(known, covariance=np.where(np.outer(free, free), known.covariance, 0.0))


def with_camera(scenario: Scenario, values: Array) -> Scenario:
    """Return a scenario with other intrinsics, (7,), as its nominal ones."""
    u0, v0, f, *distortion = values.tolist()
    return scenario.replace({'camera.principal_point_px': (u0, v0), 'camera.focal_length_mm': f,
                             'camera.distortion': tuple(distortion)})


class CameraMethod(Protocol):
    """A calibration in progress; ``start`` of each calibration method makes one."""

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take gyro samples, in the order in which they arrived."""

    def add_frames(self, frames: Frames) -> None:
        """Take frames, in the order in which they arrived."""

    def estimate(self) -> CameraEstimate | None:
        """Return the camera from all that has come so far; None while there is nothing to say."""

    def take_notices(self) -> list[str]:
        """Return what happened that a user should know, once."""
