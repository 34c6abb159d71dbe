# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gyro readings and frames as they arrive, to those that are believed, in order.

What every calibration, live or offline, makes of its two topics first: what no sensor gives is
left out (`plausible`), and `timeline` tells which stamps are believed, topic by topic. Where the
clock of both was set back, or that of the only topic there is, a new stretch begins. Where that of
one topic alone was, and the other goes on past the time at which it is caught up with, what came
too late is dropped.
"""

from __future__ import annotations

from dataclasses import replace
from enum import Enum
from itertools import chain
from typing import Any

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.units import NS
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.plausible import Plausible
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.measurements.timeline import NEVER_NS, Dropped, Timeline

GYRO_KEPT_NS = 3600 * 10**9
"""Time for which readings are kept while no frame comes."""
FRAMES_KEPT = 20_000
"""Frames that are kept while no reading comes."""

_NO_FRAMES = Frames.empty()
_ONE_SIDED_NS = 5 * 10**9   # time that one topic goes on without the other's jump


def in_gyro_time(frames: Frames, scenario: Scenario) -> Frames:
    """Return frames at the time that their stamps mean, as far as the scenario knows."""
    late_ns = round(scenario.star_tracker.time_offset_s * 1e9)
    return replace(frames, stamp_ns=frames.stamp_ns - late_ns) if late_ns else frames


class Change(Enum):
    """What became of a clock that was set back."""

    REJOINED = 'one topic has caught up'
    RESTARTED = 'a new stretch has begun'


class Intake:
    """The two topics of one calibration.

    Parameters
    ----------
    scenario : Scenario
        Rates of gyro and star tracker.
    notices : Notices
        Where it is said what was dropped.
    """

    def __init__(self, scenario: Scenario, notices: Notices) -> None:
        period_ns, leap = 1e9 / scenario.gyro.rate_hz, scenario.estimator.leap_periods
        self._gyro_time = Timeline[GyroSamples](
            period_ns, round(GYRO_KEPT_NS / period_ns), leap)
        self._frame_time = Timeline[Frames](
            1e9 / scenario.star_tracker.rate_hz, FRAMES_KEPT, leap)
        self._plausible = Plausible(scenario, notices)
        self._scenario = scenario
        self._notices = notices
        self._gyro: list[GyroSamples] = []
        self._frames: list[Frames] = []
        self._dropped = 0

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take gyro samples, in the order in which they arrived."""
        self._gyro += self._gyro_time.add(self._plausible.gyro(samples))
        self._account('gyro reading', self._gyro_time.take_dropped())

    def add_frames(self, frames: Frames) -> None:
        """Take frames, in the order in which they arrived."""
        frames = in_gyro_time(self._plausible.frames(frames), self._scenario)
        self._frames += self._frame_time.add(frames)
        self._account('frame', self._frame_time.take_dropped())

    def take(self) -> tuple[GyroSamples, Frames]:
        """Return what is believed by now and has not been taken, of the present stretch."""
        gyro, frames = self._gyro, self._frames
        self._gyro, self._frames = [], []
        # Live, one batch of one of the two comes at a time.
        return (gyro[0] if len(gyro) == 1 else GyroSamples.concatenate(gyro),
                Frames.concatenate(frames) if frames else _NO_FRAMES)

    def take_dropped(self) -> int:
        """Return how many messages were dropped since the last call."""
        dropped, self._dropped = self._dropped, 0
        return dropped + self._plausible.take_dropped()

    @property
    def waiting(self) -> int:
        """Number of frames of later stretches."""
        return sum(map(len, chain(*self._frame_time.later)))

    def settle(self) -> Change | None:
        """Settle what became of a clock that was set back, where that can be told by now.

        To be called when all that could be taken is used up; after a change more can be taken.
        """
        gyro, frames = self._gyro_time, self._frame_time
        if _one_sided(gyro, frames):
            self._gyro += gyro.rejoin()
            self._account('gyro reading', gyro.take_dropped())
            return Change.REJOINED
        if _one_sided(frames, gyro):
            self._frames += frames.rejoin()
            self._account('frame', frames.take_dropped())
            return Change.REJOINED
        if not frames.later or not (gyro.later or gyro.end_ns == NEVER_NS):
            return None
        before_ns = gyro.end_ns if gyro.later else frames.end_ns
        self._gyro = gyro.begin_next() if gyro.later else []
        self._frames = frames.begin_next()
        begins_ns = int((self._gyro or self._frames)[0].stamp_ns[0])
        self._notices.say(f'stamps went back by {(before_ns - begins_ns) * NS:.3f} s to '
                          f'{begins_ns} ns: started again')
        return Change.RESTARTED

    def _account(self, what: str, dropped: list[Dropped]) -> None:
        for number, stamp_ns, ahead in dropped:
            self._dropped += number
            self._notices.once((what, ahead), f'{what} at {stamp_ns} ns is ' + (
                'ahead of those that follow' if ahead else 'not newer than the one before')
                + ': dropped')


def _one_sided(back: Timeline[Any], other: Timeline[Any]) -> bool:
    """Tell whether a clock was set back and has caught up, while the other topic went on."""
    overtaken_ns = back.overtaken_ns
    return overtaken_ns is not None and other.end_ns >= overtaken_ns + _ONE_SIDED_NS
