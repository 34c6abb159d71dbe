# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""S24: the camera from interstar angles, of identified stars (T) or of followed spots (S).

Which of the four methods is ``intrinsics.interstar_equations``; their equations, and the letters
OC and WC, are in `interstar_equations`. The self-calibration needs no identification:
`spot_tracker` follows the stars from frame to frame. The camera is the project's: distortion is
taken off exactly, about the principal point of the moment, and its coefficients are estimated
where ``intrinsics.estimate`` names them. SCOC is freed of its bias (`interstar_solver`).

Windows
-------
The spots of a recording are kept in windows of `FRAMES` frames, whose sums add up. In T every
frame counts, each for itself. In S a window holds the tracks of consecutive frames that differ:
each is turned from the one before by at least `APART` of the field's half diagonal, roll
included, because frames alike tell nothing by comparison. Stars that come and go are missing
spots. The last `WINDOWS` windows count, which is more than two hours at 2 Hz.

Each window is linearised anew when the camera has moved by `STALE` sigmas since: a live node can
ask for the camera after every frame, and gets that of the whole recording.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from starcal_ros.calibration.interstar_solver import (Frame, InterstarSolver, Window, followed,
                                                      identified)
from starcal_ros.config.models import detector, nominal_camera
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.units import NS
from starcal_ros.measurements.gyro_buffer import GyroBuffer
from starcal_ros.measurements.intake import GYRO_KEPT_NS
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.measurements.spot_tracker import SpotTracker
from starcal_ros.measurements.star_directions import StarDirections

FRAMES, WINDOWS = 64, 400
APART = 1.0 / 32.0

_SILENCE_S = 1.0        # how long frames wait for the gyro


def start(scenario: Scenario, known: CameraEstimate | None = None) -> Interstar:
    """Begin a calibration with the scenario's ``intrinsics.interstar_equations``."""
    return Interstar(scenario, known)


class Interstar:
    """A calibration in progress, as a `CameraMethod`.

    Parameters
    ----------
    scenario : Scenario
        Nominal values, observer, and the group ``intrinsics``.
    known : CameraEstimate, optional
        In place of the nominal camera, from other frames; no prior is taken from it.

    Raises
    ------
    ConfigError
        Where nothing is to be estimated.
    """

    def __init__(self, scenario: Scenario, known: CameraEstimate | None = None) -> None:
        options, size = scenario.intrinsics, detector(scenario.camera)
        nominal = nominal_camera(scenario, known).intrinsics
        estimated = [k for k, name in enumerate(camera.INTRINSICS) if name in options.estimate]
        if not estimated:
            raise ConfigError('intrinsics.estimate: got nothing, needs one intrinsic at least')
        self._traditional = options.interstar_equations.startswith('T')
        self._fit = InterstarSolver(size, nominal, estimated,
                                    options.interstar_equations.endswith('WC'))
        half_mm = 0.5 * np.hypot(size.width, size.height) * size.pitch_mm
        self._apart = APART * float(np.arctan(half_mm / nominal[2]))
        self._directions, self._tracker = StarDirections(scenario), SpotTracker(scenario)
        self._gyro = GyroBuffer()
        self._waiting = Frames.empty()
        self._turn: Array | None = None                 # since the last frame that was kept
        self._open: list[Frame] = []                    # frames of a window that is not full yet
        self._windows: deque[Window] = deque(maxlen=WINDOWS)
        self._estimate: CameraEstimate | None = None
        self._changed = False                           # whether it lacks what has come since
        self._notices = Notices()
        self.take_notices = self._notices.take

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take gyro samples; T needs none."""
        if not self._traditional:
            self._gyro.add(samples)

    def add_frames(self, frames: Frames) -> None:
        """Take frames."""
        if self._traditional:
            self._take_identified(frames)
        else:
            self._waiting = Frames.concatenate((self._waiting, frames))

    def estimate(self) -> CameraEstimate | None:
        """Return the camera from all frames that have come."""
        self._follow()
        if self._changed:
            self._changed = False
            windows = [*self._windows, *([self._window()] if self._open else [])]
            found = self._fit.solve(windows)
            if found is None and self._windows:
                self._notices.once('none', (
                    f'{len(windows)} windows of {FRAMES} frames do not tell the camera yet: it '
                    'needs stars in other parts of the field, or fewer intrinsics.estimate'))
            self._estimate = None if found is None else CameraEstimate(
                *found, sum(int(window.seen.any(axis=-1).sum()) for window in windows),
                sum(int(window.seen.sum()) for window in windows))
        return self._estimate

    # Coming in

    def _take_identified(self, frames: Frames) -> None:
        stars = self._directions.of(frames, self._notices)
        usable = np.isfinite(stars.sigma)
        for low, high in zip(frames.first[:-1], frames.first[1:]):
            rows = low + np.flatnonzero(usable[low:high])
            if len(rows) > 1:
                self._keep((stars.uv[rows], stars.sigma[rows], stars.u_i[rows]))

    def _follow(self) -> None:
        """Follow the spots of the frames that the gyro has reached, or that waited in vain."""
        frames = self._waiting
        if not len(frames):
            self._gyro.keep_last(GYRO_KEPT_NS)
            return
        reached = int(np.searchsorted(frames.stamp_ns, self._gyro.newest_ns, side='right'))
        ready = len(frames)
        if len(self._gyro):
            overdue = frames.stamp_ns < frames.stamp_ns[-1] - _SILENCE_S / NS
            ready = max(reached, int(overdue.sum()))
        self._take_followed(frames[:reached], self._gyro.everything)
        self._take_followed(frames[reached:ready], None)
        self._waiting = frames[ready:]
        if ready:
            self._gyro.forget_before(int(frames.stamp_ns[ready - 1]))

    def _take_followed(self, frames: Frames, gyro: GyroSamples | None) -> None:
        if not len(frames):
            return
        followed = self._tracker.follow(frames, gyro)
        uv, sigma, _ = self._directions.centroids(frames, self._notices)
        for k, turn in enumerate(followed.turn):
            if self._turn is not None:
                self._turn = turn @ self._turn
                if np.trace(self._turn) > 1.0 + 2.0 * np.cos(self._apart):
                    continue
            self._turn = np.eye(3)
            rows = np.arange(frames.first[k], frames.first[k + 1])
            rows = rows[followed.track[rows] >= 0]
            self._keep((uv[rows], sigma[rows], followed.track[rows]))

    def _keep(self, frame: Frame) -> None:
        self._changed = True
        self._open.append(frame)
        if len(self._open) == FRAMES:
            self._windows.append(self._window())
            self._open = []

    def _window(self) -> Window:
        return identified(self._open) if self._traditional else followed(self._open)
