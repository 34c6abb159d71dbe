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
from scipy.stats import chi2

from starcal_ros.calibration.bundle_adjustment import MIN_STARS, Observations, adjust
from starcal_ros.calibration.bundle_start import attitudes, identified
from starcal_ros.config.models import nominal_camera, with_camera
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.measurements.samples import Frames, GyroSamples, newer
from starcal_ros.measurements.spot_tracker import SpotTracker
from starcal_ros.measurements.star_directions import StarDirections, unmeasured

FRAMES = 400
"""Frames of spots without a name that are used, at most."""

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
    """

    def __init__(self, scenario: Scenario, known: CameraEstimate | None = None) -> None:
        self.misfit = np.inf
        self._prior = nominal_camera(scenario, known)
        self._scenario = with_camera(scenario, self._prior.intrinsics)
        self._pitch_mm = scenario.camera.pixel_pitch_mm
        self._gate = float(chi2.ppf(scenario.estimator.gate_probability, 2))
        self._directions = StarDirections(scenario)
        self._newest_ns = int(np.iinfo(np.int64).min)
        self._frames: list[Frames] = []
        self._gyro: list[GyroSamples] = []
        self._notices: dict[object, str] = {}
        self._named: set[object] = set()

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take gyro samples; they help to follow spots without a name."""
        self._gyro.append(samples)

    def add_frames(self, frames: Frames) -> None:
        """Take frames, in the order in which they arrived."""
        fresh = newer(frames.stamp_ns, self._newest_ns)
        if not fresh.all():
            self._notice('order', f'frame at {frames.stamp_ns[~fresh][0]} ns is not newer than '
                         'the one before: dropped')
        if fresh.any():
            self._frames.append(frames.take(fresh))
            self._newest_ns = int(frames.stamp_ns[fresh][-1])

    def take_notices(self) -> list[str]:
        """Return what happened that a user should know, once."""
        told, self._notices = list(self._notices.values()), {}
        return told

    def estimate(self) -> CameraEstimate | None:
        """Adjust the camera to all frames so far; None while no frame has stars enough."""
        frames = Frames.concatenate(self._frames)
        named = (frames.catalog_id > 0).any()
        start_ = self._from_places(frames) if named else self._from_tracks(frames)
        if start_ is None:
            return None
        try:
            adjusted = adjust(start_.spots, self._prior.intrinsics, start_.C_si, start_.points,
                              self._pitch_mm, self._prior.covariance, self._gate)
        except np.linalg.LinAlgError:       # spots that no camera like the nominal one can see
            self._notice('lost', f'{len(start_.spots.frame)} spots do not fit a camera that is '
                         'anything like the nominal one')
            return None
        self.misfit = adjusted.scale
        used = int(adjusted.used.sum())
        if used < len(adjusted.used):
            self._notice('rejected', f'{len(adjusted.used) - used} of {len(adjusted.used)} stars '
                         'rejected')
        return CameraEstimate(adjusted.intrinsics, adjusted.covariance, len(adjusted.C_si), used)

    def _from_places(self, frames: Frames) -> _Start | None:
        placed = self._directions.of(frames)
        for key, text in placed.notices:
            self._notice(key, text)
        spots = identified(frames, placed)
        if not len(spots.frame):
            return None
        r_s = camera.unproject(spots.uv, self._prior.intrinsics, self._pitch_mm)
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
        frame = np.repeat(np.arange(len(frames)), frames.star_counts)
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
        uv, sigma, measured = self._directions.centroids(frames)
        for key, text in unmeasured(frames, sigma, measured):
            self._notice(key, text)
        kept, number = np.unique(frame[use], return_inverse=True)
        point = np.unique(followed.track[use], return_inverse=True)[1]
        spots = Observations(number, uv[use], sigma[use], np.zeros((len(number), 3)), point)
        r_s = camera.unproject(spots.uv, self._prior.intrinsics, self._pitch_mm)
        points = np.zeros((point.max() + 1, 3))
        np.add.at(points, point, (np.swapaxes(C_si[frame[use]], -1, -2) @ r_s[..., None])[..., 0])
        return _Start(spots, C_si[kept],
                      points / np.linalg.norm(points, axis=-1, keepdims=True))

    def _notice(self, key: object, text: str) -> None:
        if key not in self._named:
            self._named.add(key)
            self._notices[key] = text
