# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reference method: all frames at once, an attitude for each, see `starcal_ros.bundle`.

Where stars are identified they alone are used, at their apparent places.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from starcal_ros import camera
from starcal_ros.bundle import Adjusted, adjust, attitudes, identified
from starcal_ros.camera_estimate import CameraEstimate, beginning
from starcal_ros.config import Scenario
from starcal_ros.measurements import Frames, GyroSamples
from starcal_ros.places import Places


def start(scenario: Scenario, known: CameraEstimate | None = None) -> Bundle:
    """Begin a bundle adjustment of the camera."""
    return Bundle(scenario, known)


class Bundle:
    """Keeps the frames and adjusts the camera to all of them when it is asked for.

    Parameters
    ----------
    scenario : Scenario
        Nominal camera, observer, initial sigmas, gate.
    known : CameraEstimate, optional
        In place of the nominal camera, from other frames.
    """

    def __init__(self, scenario: Scenario, known: CameraEstimate | None = None) -> None:
        self._prior = beginning(scenario, known)
        self._pitch_mm = scenario.camera.pixel_pitch_mm
        self._gate = float(chi2.ppf(scenario.estimator.gate_probability, 2))
        self._places = Places(scenario)
        self._frames: list[Frames] = []
        self._notices: dict[object, str] = {}
        self._named: set[object] = set()
        self.adjusted: Adjusted | None = None

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take gyro samples; they are of no use here."""

    def add_frames(self, frames: Frames) -> None:
        """Take frames."""
        self._frames.append(frames)

    def take_notices(self) -> list[str]:
        """Return what happened that a user should know, once."""
        told, self._notices = list(self._notices.values()), {}
        return told

    def estimate(self) -> CameraEstimate | None:
        """Adjust the camera to all frames so far; None while no frame has stars enough."""
        frames = Frames.concatenate(self._frames)
        placed = self._places.of(frames)
        for key, text in placed.notices:
            self._notice(key, text)
        spots = identified(frames, placed)
        if not len(spots.frame):
            return None
        begin = self._prior.intrinsics if self.adjusted is None else self.adjusted.intrinsics
        C_si = attitudes(spots, camera.unproject(spots.uv, begin, self._pitch_mm))
        self.adjusted = adjust(spots, self._prior.intrinsics, C_si, np.empty((0, 3)),
                               self._pitch_mm, self._prior.covariance, self._gate)
        refused = int((~self.adjusted.used).sum())
        if refused:
            self._notice('refused', f'{refused} of {len(spots.frame)} stars refused')
        return CameraEstimate(self.adjusted.intrinsics, self.adjusted.covariance,
                              len(self.adjusted.C_si), len(spots.frame) - refused)

    def _notice(self, key: object, text: str) -> None:
        if key not in self._named:
            self._named.add(key)
            self._notices[key] = text
