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
from starcal_ros.measurements.samples import Frames, GyroSamples, newer
from starcal_ros.measurements.spot_tracker import SpotTracker
from starcal_ros.measurements.star_directions import StarDirections, unmeasured

FRAMES, WINDOWS = 64, 400
APART = 1.0 / 32.0

_SILENCE_S = 1.0        # how long frames wait for the gyro
_GYRO_KEPT_S = 3600.0   # readings kept while no frame comes
_NEVER_NS = np.iinfo(np.int64).min


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
        self._newest_ns = _NEVER_NS
        self._gyro = GyroSamples.empty()
        self._waiting: list[Frames] = []
        self._turn: Array | None = None                 # since the last frame that was kept
        self._open: list[Frame] = []                    # frames of a window that is not full yet
        self._windows: deque[Window] = deque(maxlen=WINDOWS)
        self._estimate: CameraEstimate | None = None
        self._changed = False                           # whether it lacks what has come since
        self._notices: dict[object, str] = {}
        self._said: set[object] = set()

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take gyro samples, in the order in which they arrived; T needs none."""
        if self._traditional:
            return
        last = self._gyro.stamp_ns[-1] if len(self._gyro) else _NEVER_NS
        finite = np.isfinite(samples.rate).all(axis=1)
        good = GyroSamples(samples.stamp_ns[finite], samples.rate[finite])
        fresh = newer(good.stamp_ns, last)
        self._gyro = GyroSamples.concatenate((
            self._gyro, GyroSamples(good.stamp_ns[fresh], good.rate[fresh])))

    def add_frames(self, frames: Frames) -> None:
        """Take frames, in the order in which they arrived."""
        fresh = newer(frames.stamp_ns, self._newest_ns)
        if not fresh.all():
            self._notices['order'] = (f'frame at {frames.stamp_ns[~fresh][0]} ns is not newer '
                                      'than the one before: dropped')
        frames = frames.take(fresh)
        if not len(frames):
            return
        self._newest_ns = int(frames.stamp_ns[-1])
        if self._traditional:
            self._take_identified(frames)
        else:
            self._waiting.append(frames)

    def estimate(self) -> CameraEstimate | None:
        """Return the camera from all frames that have come."""
        self._follow()
        if self._changed:
            self._changed = False
            windows = [*self._windows, *([self._window()] if self._open else [])]
            found = self._fit.solve(windows)
            if found is None and self._windows:
                self._notices['none'] = (
                    f'{len(windows)} windows of {FRAMES} frames do not tell the camera yet: it '
                    'needs stars in other parts of the field, or fewer intrinsics.estimate')
            self._estimate = None if found is None else CameraEstimate(
                *found, sum(int(window.seen.any(axis=-1).sum()) for window in windows),
                sum(int(window.seen.sum()) for window in windows))
        return self._estimate

    def take_notices(self) -> list[str]:
        """Return what happened that a user should know, once."""
        notices = [text for key, text in self._notices.items() if key not in self._said]
        self._said.update(self._notices)
        self._notices.clear()
        return notices

    # Coming in

    def _take_identified(self, frames: Frames) -> None:
        stars, notices = self._directions.of(frames)
        self._notices.update(notices)
        usable = np.isfinite(stars.sigma)
        for low, high in zip(frames.first[:-1], frames.first[1:]):
            rows = low + np.flatnonzero(usable[low:high])
            if len(rows) > 1:
                self._keep((stars.uv[rows], stars.sigma[rows], stars.u_i[rows]))

    def _follow(self) -> None:
        """Follow the spots of the frames that the gyro has reached, or that waited in vain."""
        stamps = self._gyro.stamp_ns
        if not self._waiting:
            if len(stamps):
                self._forget_gyro_before(int(stamps[-1] - _GYRO_KEPT_S / NS))
            return
        frames = Frames.concatenate(self._waiting)
        reached = int(np.searchsorted(frames.stamp_ns, stamps[-1:].max(initial=_NEVER_NS),
                                      side='right'))
        ready = len(frames)
        if len(stamps):
            overdue = frames.stamp_ns < frames.stamp_ns[-1] - _SILENCE_S / NS
            ready = max(reached, int(overdue.sum()))
        self._take_followed(frames[:reached], self._gyro)
        self._take_followed(frames[reached:ready], None)
        self._waiting = [frames[ready:]] if ready < len(frames) else []
        if ready:
            self._forget_gyro_before(int(frames.stamp_ns[ready - 1]))

    def _forget_gyro_before(self, stamp_ns: int) -> None:
        # The reading at or before the stamp stays: the next one begins where it ends.
        first = int(np.searchsorted(self._gyro.stamp_ns, stamp_ns, side='right')) - 1
        self._gyro = self._gyro[max(first, 0):]

    def _take_followed(self, frames: Frames, gyro: GyroSamples | None) -> None:
        if not len(frames):
            return
        followed = self._tracker.follow(frames, gyro)
        uv, sigma, measured = self._directions.centroids(frames)
        self._notices.update(unmeasured(frames, sigma, measured))
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
