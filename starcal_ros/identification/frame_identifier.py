# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Identification of a live stream: frames of spots, as they come, to catalogue numbers.

Gyro readings carry the attitude from frame to frame, so a frame waits for those up to its stamp.
Where there are none, the last rate does.

A reading that is not newer than the last one is late and left out. When stamps go back by more
than `timeline.SET_BACK_S`, the clock was set back, or the last stamp was wrong, and the readings
before are forgotten. A frame that is not newer than the last one is searched for.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator

import numpy as np

from starcal_ros.config.models import detector, nominal_camera, observer
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Ints
from starcal_ros.identification.camera_guess import CameraGuess
from starcal_ros.identification.identifier import Identification, Identifier, MirroredError
from starcal_ros.measurements.frame_rotations import from_gyro
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.measurements.timeline import NEVER_NS, SET_BACK_S

_SET_BACK_NS = round(SET_BACK_S * 1e9)
_GYRO_KEPT, _PARTS = 500_000, 1000      # readings while no frame comes, and arrays of them


class FrameIdentifier:
    """Identifies the frames of one star tracker, in the order in which they arrive.

    The camera is the nominal one, as uncertain as ``estimator.initial_sigma`` says.

    Parameters
    ----------
    scenario : Scenario
        Camera, mounting, gyro, observer, limiting magnitude.

    Raises
    ------
    ImportError
        Where tetra3rs is missing.
    ValueError
        Where the catalogue does not reach down to the limiting magnitude.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario, camera = scenario, nominal_camera(scenario)
        self._identifier = Identifier(
            CameraGuess(detector(scenario.camera), camera.intrinsics, camera.covariance),
            observer(scenario.observer), scenario.star_identifier.limiting_magnitude)
        self._identifier.prepare()
        self._gyro: list[GyroSamples] = []
        self._gyro_ns = NEVER_NS                # of the newest reading
        self._last: Frames | None = None
        self._waiting: deque[Frames] = deque()
        self._notices: list[str] = []
        self._counts: Counter[str] = Counter()

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take readings, in the order in which they arrived."""
        samples = samples.take(np.flatnonzero(np.isfinite(samples.rate).all(axis=1)))
        while len(back := np.flatnonzero(
                samples.stamp_ns + _SET_BACK_NS < self._before(samples.stamp_ns))):
            self._gyro, self._gyro_ns = [], NEVER_NS
            samples = samples[int(back[0]):]
        samples = samples.take(samples.stamp_ns > self._before(samples.stamp_ns))
        if len(samples):
            self._gyro.append(samples)
            self._gyro_ns = int(samples.stamp_ns[-1])
        if len(self._gyro) > _PARTS:
            self._gyro = [GyroSamples.concatenate(self._gyro)[-_GYRO_KEPT:]]

    def add_frames(self, frames: Frames) -> None:
        """Take frames, in the order in which they arrived."""
        self._waiting.extend(frames[k:k + 1] for k in range(len(frames)))

    def process(self, wait: bool) -> Iterator[Ints]:
        """Yield the numbers (n,) of the spots of each frame, in order; 0 where none can be told.

        Parameters
        ----------
        wait : bool
            Whether a frame waits for gyro readings up to its stamp.
        """
        while self._waiting:
            frame = self._waiting[0]
            stamp_ns = int(frame.stamp_ns[0])
            if wait and self._gyro_ns < stamp_ns:
                return
            self._waiting.popleft()
            found = self._identify(frame, stamp_ns)
            number = (np.zeros(len(frame.catalog_id), np.int64) if found is None
                      else found.catalog_id)
            self._counts.update({
                'frames': 1, 'frames tracked': int(found is not None and found.tracked),
                'frames found by a search': int(found is not None and not found.tracked),
                'spots': len(number), 'stars': int(np.count_nonzero(number))})
            yield number

    def take_notices(self) -> list[str]:
        """Return what happened that a user should know, once."""
        notices, self._notices = self._notices, []
        return notices

    def take_counts(self) -> Counter[str]:
        """Return what has been done since the last call."""
        counts, self._counts = self._counts, Counter()
        return counts

    def _identify(self, frame: Frames, stamp_ns: int) -> Identification | None:
        turn, last, self._last = None, self._last, frame
        if last is not None and stamp_ns > last.stamp_ns[0]:
            gyro = self._gyro_since(int(last.stamp_ns[0]))
            _, turn = from_gyro(gyro, Frames.concatenate((last, frame)), self._scenario)
        with np.errstate(over='ignore', invalid='ignore'):       # a magnitude may be anything
            flux = 10.0**(-0.4 * frame.magnitude)
        flux[~np.isfinite(flux)] = np.nan
        try:
            return self._identifier.identify(frame.uv_raster, flux, stamp_ns, turn, frame.sigma)
        except MirroredError as error:
            self._notices.append(str(error))
            return None

    def _gyro_since(self, stamp_ns: int) -> GyroSamples:
        """Return the readings that cover the time since a stamp, and forget older ones."""
        gyro = GyroSamples.concatenate(self._gyro)
        first = max(int(np.searchsorted(gyro.stamp_ns, stamp_ns, side='right')) - 1, 0)
        self._gyro = [gyro[first:]]
        return self._gyro[0]

    def _before(self, stamp_ns: Ints) -> Ints:
        """Return the newest stamp before each of those of some readings."""
        return np.maximum.accumulate(np.concatenate(([self._gyro_ns], stamp_ns)))[:-1]
