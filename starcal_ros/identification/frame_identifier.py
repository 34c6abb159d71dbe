# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Identification of a live stream: frames of spots, as they come, to catalogue numbers.

Gyro readings carry the attitude from frame to frame, so a frame waits for those up to its stamp.
Where there are none, the last rate does.

Which readings are believed `timeline` tells; where their clock was set back, those before are
forgotten. Every frame is answered: one that is not newer than the last one is searched for.
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
from starcal_ros.measurements.gyro_buffer import GyroBuffer
from starcal_ros.measurements.intake import GYRO_KEPT_NS
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.plausible import Plausible
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.measurements.timeline import Timeline


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
            observer(scenario.observer), scenario.star_identifier.limiting_magnitude,
            exposure_s=scenario.star_tracker.exposure_s)
        self._identifier.prepare()
        period_ns = 1e9 / scenario.gyro.rate_hz
        self._gyro_time = Timeline[GyroSamples](
            period_ns, round(GYRO_KEPT_NS / period_ns), scenario.estimator.leap_periods)
        self._gyro = GyroBuffer()
        self._last: Frames | None = None
        self._waiting: deque[Frames] = deque()
        self._notices = Notices()
        self.take_notices = self._notices.take
        self._plausible = Plausible(scenario, self._notices)
        self._counts: Counter[str] = Counter()

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take readings, in the order in which they arrived."""
        for part in self._gyro_time.add(self._plausible.gyro(samples)):
            self._gyro.add(part)
        if dropped := self._plausible.take_dropped():
            self._counts['readings dropped'] += dropped
        while self._gyro_time.later:
            self._gyro.clear()
            for part in self._gyro_time.begin_next():
                self._gyro.add(part)
        self._gyro.keep_last(GYRO_KEPT_NS)

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
            if wait and not self._gyro.reaches(stamp_ns):
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

    def take_counts(self) -> Counter[str]:
        """Return what has been done since the last call."""
        counts, self._counts = self._counts, Counter()
        return counts

    def _identify(self, frame: Frames, stamp_ns: int) -> Identification | None:
        turn, last, self._last = None, self._last, frame
        if last is not None and stamp_ns > last.stamp_ns[0]:
            gyro = self._gyro.since(int(last.stamp_ns[0]))
            _, turn = from_gyro(gyro, Frames.concatenate((last, frame)), self._scenario)
        with np.errstate(over='ignore', invalid='ignore'):       # a magnitude may be anything
            flux = 10.0**(-0.4 * frame.magnitude)
        flux[~np.isfinite(flux)] = np.nan
        try:
            return self._identifier.identify(frame.uv_raster, flux, stamp_ns, turn, frame.sigma)
        except MirroredError as error:
            self._notices.say(str(error))
            return None
