# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What no sensor gives is left out before anything believes it.

Bounds are parameters where an instrument may need another value. The sigma and the place of a
single star are judged in `star_directions`, which leaves out the star and not its frame.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from starcal_ros.config.scenario import Scenario, stamp_ns
from starcal_ros.core.units import DEG
from starcal_ros.core.utc import utc_text
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.samples import Frames, GyroSamples

_FAINTEST = 40.0            # magnitude of a star that nobody has seen yet

M = TypeVar('M', GyroSamples, Frames)


class Plausible:
    """The messages of gyro and star tracker that may be true.

    Parameters
    ----------
    scenario : Scenario
        Range of the gyro, and the time that stamps may tell.
    notices : Notices
        Where the first of each kind that is left out is named.
    """

    def __init__(self, scenario: Scenario, notices: Notices) -> None:
        self._largest_rate = scenario.gyro.largest_rate_deg_s * DEG
        self._earliest_ns, self._latest_ns = (
            stamp_ns(f'estimator.{name}', getattr(scenario.estimator, name))
            for name in ('earliest_utc', 'latest_utc'))
        self._notices = notices
        self._dropped = 0

    def gyro(self, samples: GyroSamples) -> GyroSamples:
        """Return the readings that are numbers in the range of the gyro, and of this time."""
        plausible = samples.plausible(self._largest_rate)
        if not plausible.all():
            rate = ', '.join(f'{part:g}' for part in samples.rate[~plausible][0].tolist())
            self._notices.once('rate', f'gyro reading at {samples.stamp_ns[~plausible][0]} ns is '
                               f'{rate} rad/s, gyro.largest_rate_deg_s is '
                               f'{self._largest_rate / DEG:g}: dropped')
            self._dropped += int((~plausible).sum())
            samples = samples.take(plausible)
        return self._of_the_time('gyro reading', samples)

    def frames(self, frames: Frames) -> Frames:
        """Return the frames of this time, without the magnitudes that no star has."""
        known = np.abs(frames.magnitude) <= _FAINTEST
        if not known.all():
            frames = replace(frames, magnitude=np.where(known, frames.magnitude, np.nan))
        return self._of_the_time('frame', frames)

    def take_dropped(self) -> int:
        """Return how many messages were left out since the last call."""
        dropped, self._dropped = self._dropped, 0
        return dropped

    def _of_the_time(self, what: str, messages: M) -> M:
        """Return the messages whose stamps may be UTC."""
        stamps = messages.stamp_ns
        early, late = stamps < self._earliest_ns, stamps > self._latest_ns
        if not (early | late).any():
            return messages
        for wrong, name, limit_ns in ((early, 'earliest_utc', self._earliest_ns),
                                      (late, 'latest_utc', self._latest_ns)):
            if wrong.any():
                self._notices.once((what, name), (
                    f'{what} stamped {utc_text(int(stamps[wrong][0]))}, estimator.{name} is '
                    f'{utc_text(limit_ns)}: dropped'))
        self._dropped += int((early | late).sum())
        return messages.take(~(early | late))
