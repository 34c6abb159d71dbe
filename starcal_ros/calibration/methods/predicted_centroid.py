# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18: all 16 states from predicted star centroids, the gyro carrying the attitude.

The recording's messages go through the same `Calibrator` as in the live estimator.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.calibration.residual_tests import Consistency
from starcal_ros.config.models import with_camera
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import CALIBRATED, LENS


def start(scenario: Scenario, known: CameraEstimate | None = None) -> PredictedCentroid:
    """Begin a calibration of which only the camera is asked for."""
    return PredictedCentroid(scenario, known)


def begin(scenario: Scenario, known: CameraEstimate | None = None) -> Calibrator:
    """Return a calibrator that has seen nothing, at what other frames tell of the camera."""
    if known is None:
        return Calibrator(scenario)
    covariance = np.diag(Filter(scenario).initial_sigma[CALIBRATED]**2)
    lens = slice(LENS.start - CALIBRATED.start, None)
    covariance[lens, lens] = known.covariance
    return Calibrator(with_camera(scenario, known.intrinsics), covariance)


class PredictedCentroid:
    """The 16-state filter as a `CameraMethod`.

    Parameters
    ----------
    scenario : Scenario
        Nominal values and estimator options; all seven intrinsics are estimated.
    known : CameraEstimate, optional
        In place of the nominal camera, from other frames.
    """

    def __init__(self, scenario: Scenario, known: CameraEstimate | None = None) -> None:
        self._calibrator = begin(scenario, known)
        self.add_gyro = self._calibrator.add_gyro
        self.add_frames = self._calibrator.add_frames
        self.take_notices = self._calibrator.take_notices

    @property
    def consistency(self) -> Consistency:
        """What the innovations say."""
        tests = self._calibrator.consistency
        statistics = tests.statistics()
        passed = all(each.passed for each in statistics)
        factor = 1.0 if passed else max(tests.variance_factors())
        return Consistency(statistics, None, (factor,) * 7)

    def estimate(self) -> CameraEstimate | None:
        """Return the camera after the last frame that the gyro has reached."""
        for _ in self._calibrator.process():
            pass
        belief, counts = self._calibrator.belief, self._calibrator.counts
        if belief is None:
            return None
        return CameraEstimate(belief.estimate.intrinsics, belief.covariance[LENS, LENS],
                              counts.frames, counts.stars)
