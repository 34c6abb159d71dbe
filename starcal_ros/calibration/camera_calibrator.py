# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A method that calibrates the camera alone, run on messages as they arrive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from starcal_ros.calibration import camera_verdict, residual_trends
from starcal_ros.calibration.camera_verdict import CameraVerdict
from starcal_ros.calibration.frame_sample import FrameSample
from starcal_ros.calibration.method import CameraMethod
from starcal_ros.calibration.residual_tests import Consistency
from starcal_ros.config.models import detector
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.measurements.intake import Change, Intake
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.measurements.timeline import NEVER_NS


class CameraCalibrator:
    """Hands a method the messages that are believed, in order; itself a `CameraMethod`.

    Where the clock was set back the calibration starts again: frames that are sent once more tell
    nothing new.

    Parameters
    ----------
    scenario : Scenario
        Rates of gyro and star tracker.
    begin : callable
        Returns the method at its beginning.

    Attributes
    ----------
    stamp_ns : int
        Of the newest frame that the method has; NEVER_NS where it has none.
    """

    def __init__(self, scenario: Scenario, begin: Callable[[], CameraMethod]) -> None:
        self._scenario = scenario
        self._begin, self._method = begin, begin()
        self._sample = FrameSample(camera_verdict.FRAMES)
        self._notices = Notices()
        self._intake = Intake(scenario, self._notices)
        self.stamp_ns = NEVER_NS

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take gyro samples, in the order in which they arrived."""
        self._intake.add_gyro(samples)

    def add_frames(self, frames: Frames) -> None:
        """Take frames, in the order in which they arrived."""
        self._intake.add_frames(frames)

    def estimate(self) -> CameraEstimate | None:
        """Return the camera from all that has come so far; None while there is nothing to say."""
        self._hand_over()
        while change := self._intake.settle():
            if change is Change.RESTARTED:
                self._method = self._begin()
                self._sample = FrameSample(camera_verdict.FRAMES)
            self._hand_over()
        return self._method.estimate()

    def judge(self, estimate: CameraEstimate, most_stars: int = camera_verdict.STARS
              ) -> CameraVerdict:
        """Return the verdict on the estimate of the frames so far, at a bounded cost.

        Parameters
        ----------
        estimate : CameraEstimate
        most_stars : int
            Stars that are looked at, of some frames of all.
        """
        found = camera_verdict.of_frames(self._sample.frames, estimate, self._scenario,
                                         most_stars)
        own = getattr(self._method, 'consistency', None)
        if isinstance(own, Consistency):
            found = found.beside(own)
        return camera_verdict.judge(found, estimate, self._scenario)

    def trends(self, estimate: CameraEstimate) -> dict[str, list[dict[str, Any]]]:
        """Return how residuals depend on pixel, magnitude and colour; empty without numbers."""
        fitted = camera_verdict.held(self._sample.frames, estimate, self._scenario)
        if isinstance(fitted, str):
            return {}
        return residual_trends.of_stars(fitted.stars, fitted.catalog_id[fitted.adjusted.used],
                                        detector(self._scenario.camera))

    def take_notices(self) -> list[str]:
        """Return what happened that a user should know, once."""
        return self._notices.take() + self._method.take_notices()

    def _hand_over(self) -> None:
        gyro, frames = self._intake.take()
        self._method.add_gyro(gyro)
        self._method.add_frames(frames)
        self._sample.add(frames)
        if len(frames):
            self.stamp_ns = int(frames.stamp_ns[-1])
