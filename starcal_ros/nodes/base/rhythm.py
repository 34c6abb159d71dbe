# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Results in the rhythm of their readings, also when they have been held up.

At real time a reading comes every period, and its attitude goes out at once. What the publisher is
held up with, by its first frame or by the machine, would go out in a burst, and overrun who keeps
but ten messages, as rosbag2 does. Such a backlog goes out at four times the rate of the readings.
Where readings come faster than they were measured, as in a run without a clock, nothing can be
spread, and nothing is.

Whether they do tells the age of the newest reading, by a clock that need not be that of its stamp.
At real time the least age of every few seconds is the same; in a faster run it falls. Whatever it
says, no backlog is spread for longer than PATIENCE_S: what comes in must go out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
import time
from typing import TypeVar

from starcal_ros.core.arrays import Ints
from starcal_ros.core.units import NS
from starcal_ros.measurements.timeline import NEVER_NS

T = TypeVar('T')

CATCH_UP = 4.0          # times the rate of the readings
BURST = 5               # messages that may go out at once
GATHER_S = 0.05         # longest time that a reading waits for others
PATIENCE_S = 5.0        # makes up for 20 s at real time
_WINDOW_S = 5.0         # over which the least age is taken
_WINDOWS = 3            # of which the first is compared with
_YOUNGER_S = 1.0        # than then: a faster run


class Rhythm:
    """Paces what goes out by what comes in.

    Parameters
    ----------
    rate_hz : float
        Of the readings.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz, self._fastest_hz = rate_hz, CATCH_UP * rate_hz
        self._least_s: deque[float] = deque(maxlen=_WINDOWS)    # ages
        self._began_s = self._sent_s = self._heard_s = 0.0
        self._newest_ns = NEVER_NS
        self._level = 0.0           # messages that went out early
        self._waited_s = 0.0        # since there were none
        self.real_time = True

    def heard(self, stamp_ns: Ints) -> None:
        """Take the stamps of readings that have just come, (n,), at least one."""
        now_s, newest_ns = time.monotonic(), int(stamp_ns[-1])
        age_s, self._heard_s = now_s - newest_ns * NS, now_s
        if newest_ns < self._newest_ns:         # the clock was set back
            self._least_s.clear()
        self._newest_ns = newest_ns
        if not self._least_s:
            self._least_s.append(now_s - stamp_ns[0] * NS)
        if len(self._least_s) == 1 or now_s > self._began_s + _WINDOW_S:
            self._least_s.append(age_s)
            self._began_s = now_s
        self._least_s[-1] = min(self._least_s[-1], age_s)
        self.real_time = bool(age_s > self._least_s[0] - _YOUNGER_S)

    @property
    def gather_s(self) -> float:
        """How long readings may gather: for no burst, and for GATHER_S at most."""
        return min(BURST / self._rate_hz, GATHER_S)

    def may_have_come(self, stamp_ns: int) -> bool:
        """Tell whether a reading of such a stamp, or a later one, may have come by now."""
        passed_s = time.monotonic() - self._heard_s + 2.0 / self._rate_hz
        return not self.real_time or stamp_ns <= self._newest_ns + passed_s / NS

    def spread(self, messages: Iterable[T]) -> Iterator[T]:
        """Yield each message when it may go out."""
        for message in messages:
            if self.real_time:
                self._wait()
            yield message

    def _wait(self) -> None:
        now_s = time.monotonic()
        self._level = max(self._level - (now_s - self._sent_s) * self._fastest_hz, 0.0) + 1.0
        self._sent_s = now_s
        if self._level == 1.0:
            self._waited_s = 0.0
        if self._level > BURST and self._waited_s < PATIENCE_S:
            wait_s = (self._level - BURST) / self._fastest_hz
            self._waited_s += wait_s
            time.sleep(wait_s)
