# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reference method: all frames at once, an attitude for each (`bundle_adjustment`).

Where stars are identified they alone are used, at their apparent places. Where none is, the spots
are followed from frame to frame (`spot_tracker`), and the directions of the tracks are unknowns as
well: the self-calibration that leaves nothing out. It takes FRAMES of the frames then, evenly
spread; more of them would lie too close together to tell much that is new.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.calibration import residual_tests
from starcal_ros.calibration.bundle_adjustment import adjust
from starcal_ros.calibration.bundle_problem import MIN_STARS, Observations
from starcal_ros.calibration.bundle_start import attitudes, identified
from starcal_ros.calibration.residual_tests import Consistency
from starcal_ros.config.models import nominal_camera, own_focal_sigma_mm, star_gate, with_camera
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.core.statistic import gated_nis
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.measurements.spot_tracker import SpotTracker
from starcal_ros.measurements.star_directions import StarDirections

FRAMES = 400
"""Frames of unidentified spots that are used, at most."""

_SIGHTINGS = 3          # frames that must show a track: two can be fitted whatever they are


def start(scenario: Scenario, known: CameraEstimate | None = None) -> Bundle:
    """Begin a bundle adjustment of the camera."""
    return Bundle(scenario, known)


class _Start(NamedTuple):
    """Observations, and where their adjustment begins."""

    spots: Observations
    C_si: Array
    points: Array


class Bundle:
    """Keeps the frames and adjusts the camera to all of them when it is asked for.

    Parameters
    ----------
    scenario : Scenario
        Nominal camera, observer, initial sigmas, gate.
    known : CameraEstimate, optional
        In place of the nominal camera, from other frames.

    Attributes
    ----------
    misfit : float
        Size of the residuals over what the sigmas promise, of the last estimate.
    consistency : Consistency
        What the residuals of unidentified spots say of the last estimate.
    own_f : (n, 2) array or None
        Focal length of each frame with stars enough, and its sigma (``intrinsics.free``) [mm].
    """

    def __init__(self, scenario: Scenario, known: CameraEstimate | None = None) -> None:
        self.misfit, self.consistency = np.inf, Consistency()
        self.own_f: Array | None = None
        self._own_f_sigma = own_focal_sigma_mm(scenario)
        self._prior = nominal_camera(scenario, known)
        self._scenario = with_camera(scenario, self._prior.intrinsics)
        self._lens = Tan2018Lens(scenario.camera.pixel_pitch_mm)
        self._gate = star_gate(scenario.estimator)
        self._gated = gated_nis(scenario.estimator.gate_probability)
        self._directions = StarDirections(scenario)
        self._frames: list[Frames] = []
        self._gyro: list[GyroSamples] = []
        self._notices = Notices()
        self.take_notices = self._notices.take

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take gyro samples; they help to follow unidentified spots."""
        self._gyro.append(samples)

    def add_frames(self, frames: Frames) -> None:
        """Take frames."""
        self._frames.append(frames)

    def estimate(self) -> CameraEstimate | None:
        """Adjust the camera to all frames so far; None while no frame has stars enough."""
        frames = Frames.concatenate(self._frames)
        identified_ = (frames.catalog_id > 0).any()
        if self._own_f_sigma and not identified_:
            self._notices.once('own', 'intrinsics.free: a focal length for each frame needs '
                               'identified stars')
            return None
        start_ = self._from_stars(frames) if identified_ else self._from_tracks(frames)
        if start_ is None:
            return None
        try:
            adjusted = adjust(start_.spots, self._prior.intrinsics, start_.C_si, start_.points,
                              self._lens, self._prior.covariance, self._gate,
                              self._own_f_sigma)
        except np.linalg.LinAlgError:       # spots that no camera like the nominal one can see
            self._notices.once('lost', f'{len(start_.spots.frame)} spots do not fit a camera '
                               'that is anything like the nominal one')
            return None
        self.misfit = adjusted.scale
        self.consistency = Consistency() if identified_ else residual_tests.of_unidentified(
            adjusted, start_.spots.sigma, self._gated)
        self.own_f = adjusted.own_f
        used = int(adjusted.used.sum())
        if used < len(adjusted.used):
            self._notices.once('rejected', f'{len(adjusted.used) - used} of '
                               f'{len(adjusted.used)} stars rejected')
        return CameraEstimate(adjusted.intrinsics, adjusted.covariance, len(adjusted.C_si), used)

    def _from_stars(self, frames: Frames) -> _Start | None:
        spots = identified(frames, self._directions.of(frames, self._notices))
        if not len(spots.frame):
            return None
        r_s = self._lens.unproject(spots.uv, self._prior.intrinsics)
        return _Start(spots, attitudes(spots, r_s), np.empty((0, 3)))

    def _from_tracks(self, frames: Frames) -> _Start | None:
        if len(frames) < _SIGHTINGS:
            return None
        gyro = GyroSamples.concatenate(self._gyro)
        reached = len(gyro) and gyro.stamp_ns[-1] >= frames.stamp_ns[-1]
        followed = SpotTracker(self._scenario).follow(frames, gyro if reached else None)
        C_si = followed.turn.copy()
        for k in range(1, len(C_si)):
            C_si[k] = C_si[k] @ C_si[k - 1]
        frame = frames.frame_index
        chosen = np.zeros(len(frames), bool)
        chosen[np.linspace(0, len(frames) - 1, min(FRAMES, len(frames))).astype(int)] = True
        use = chosen[frame] & (followed.track >= 0)
        while True:     # what a frame or a track lacks may take the other below its least
            sightings = np.bincount(followed.track[use], minlength=followed.track.max() + 1)
            stars = np.bincount(frame[use], minlength=len(frames))
            poor = use & ((sightings[followed.track] < _SIGHTINGS) | (stars[frame] < MIN_STARS))
            if not poor.any():
                break
            use &= ~poor
        if not use.any():
            return None
        uv, sigma, _ = self._directions.centroids(frames, self._notices)
        kept, number = np.unique(frame[use], return_inverse=True)
        point = np.unique(followed.track[use], return_inverse=True)[1]
        spots = Observations(number, uv[use], sigma[use], np.zeros((len(number), 3)), point)
        r_s = self._lens.unproject(spots.uv, self._prior.intrinsics)
        points = np.zeros((point.max() + 1, 3))
        np.add.at(points, point, (np.swapaxes(C_si[frame[use]], -1, -2) @ r_s[..., None])[..., 0])
        return _Start(spots, C_si[kept],
                      points / np.linalg.norm(points, axis=-1, keepdims=True))
