# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One topic that the recorder records: its log times, what is pending, what is missing.

The log time of a message is its stamp. Where a clock is set back, as by a replay in a loop or a
simulation that starts again, the time of the recording goes on: all that follows is moved by as
much, on all topics alike. Readers go by the log times; laps on top of each other, or a lap in one
instant, would be a recording of something else.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from starcal_ros.nodes.base.stamps import FAR_NS
from starcal_ros.recording.losses import StampGaps
from starcal_ros.recording.qos import Qos
from starcal_ros.recording.writer import Batch

LATEST = 100                    # latched messages of a publisher that are told from new ones
_LATE_NS = 10**9                # by which a stamp may be late without being that of a new lap


@dataclass
class RunTime:
    """The time of a recording: how far the last clock that was set back is behind it [ns]."""

    offset_ns: int = 0


@dataclass
class Channel:
    """One recorded topic and its messages since the last flush."""

    name: str
    type_name: str
    latched: bool
    stamp_ns: Callable[[bytes], int | None]     # of a message
    of_ros: bool            # its stamps are ROS time, not those of the sensors
    source: str             # topics of one source run by one clock
    run: RunTime = field(default_factory=RunTime)       # of all topics of the recording
    qos: tuple[Qos, ...] = ()
    newest_ns: int = 0
    offset_ns: int = 0              # of its own stamps behind the time of the recording
    is_odd: bool = False            # the last stamp, far ahead or back, and not believed
    log_times_ns: list[int | None] = field(default_factory=list)
    own_stamps_ns: list[int] = field(default_factory=list)      # those of its own among them
    messages: list[bytes] = field(default_factory=list)
    count: int = 0
    lost_by_middleware: int = 0     # up to a pause
    gaps: StampGaps = field(default_factory=lambda: StampGaps(FAR_NS * 1e-9))
    latest: deque[bytes] = field(default_factory=lambda: deque(maxlen=LATEST))
    known: set[bytes] = field(default_factory=set)      # latched, and recorded before a pause

    def take(self, batch: list[bytes], newest_ns: int | None) -> int | None:
        """Keep messages until the next flush.

        Parameters
        ----------
        batch : list of bytes
        newest_ns : int or None
            Newest log time of the source, None for none so far.

        Returns
        -------
        newest_ns : int or None
            The same, after them.
        """
        if self.known:          # a latched message comes once more to who subscribes again
            batch, given = [message for message in batch if message not in self.known], batch
            self.known.difference_update(given)
        stamps_ns = [*map(self.stamp_ns, batch)]
        if self._goes_on(stamps_ns):
            self.own_stamps_ns += stamps_ns
            self.log_times_ns += stamps_ns
            self.newest_ns, newest_ns = stamps_ns[-1], max(newest_ns or 0, stamps_ns[-1])
            self.is_odd, stamps_ns = False, []
        for stamp_ns in stamps_ns:
            if self.of_ros or stamp_ns is None:
                log_time = None if newest_ns is None else self._near(stamp_ns, newest_ns)
            else:
                log_time = self._log_time_ns(stamp_ns)
                newest_ns = max(newest_ns or 0, log_time)
                self.own_stamps_ns.append(log_time)
            self.log_times_ns.append(log_time)
        self.messages += batch
        self.latest.extend(batch[-LATEST:])
        self.count += len(batch)
        return newest_ns

    def pending(self, first_ns: int | None) -> Batch:
        """Hand over the messages since the last flush; those without a time get the first."""
        if self.own_stamps_ns:
            self.gaps.add(self.own_stamps_ns)
        log_time = [self._near(self.stamp_ns(message), first_ns) if t is None else t
                    for t, message in zip(self.log_times_ns, self.messages)]
        batch = Batch(self.name, self.type_name, np.array(log_time, np.int64), self.messages,
                      self.qos)
        self.messages, self.log_times_ns, self.own_stamps_ns = [], [], []
        return batch

    def _goes_on(self, stamps_ns: list[int | None]) -> bool:
        """Tell whether stamps are log times as they are: no clock was set back, nor is one now."""
        if self.of_ros or self.offset_ns or self.run.offset_ns or not self.newest_ns:
            return False
        if None in stamps_ns or not stamps_ns:
            return False
        return (stamps_ns == sorted(stamps_ns) and self.newest_ns <= stamps_ns[0]
                and stamps_ns[-1] <= self.newest_ns + FAR_NS)

    def _log_time_ns(self, stamp_ns: int) -> int:
        """Return the log time of the next message, no earlier than that of the one before.

        A stamp far ahead or back is believed when the next one is far, too.
        """
        if not self.newest_ns:
            self.offset_ns, self.newest_ns = self.run.offset_ns, stamp_ns + self.run.offset_ns
            return self.newest_ns
        after_ns = {offset: stamp_ns + offset - self.newest_ns
                    for offset in (self.offset_ns, self.run.offset_ns, 0)}
        fitting = [offset for offset, ns in after_ns.items() if -_LATE_NS <= ns <= FAR_NS]
        if fitting:
            self.offset_ns = min(fitting, key=lambda offset: abs(after_ns[offset]))
        elif self.is_odd and after_ns[self.offset_ns] < 0:
            self.offset_ns = self.run.offset_ns = self.newest_ns - stamp_ns
        if fitting or self.is_odd:
            self.newest_ns = max(self.newest_ns, stamp_ns + self.offset_ns)
        self.is_odd = not fitting and not self.is_odd
        return self.newest_ns

    def _near(self, stamp_ns: int | None, newest_ns: int) -> int:
        """Return a stamp, or that of the run where there is none or it is of another clock."""
        if stamp_ns is None:
            return newest_ns
        log_time = min((stamp_ns, stamp_ns + self.run.offset_ns),
                       key=lambda each: abs(each - newest_ns))
        return newest_ns if abs(log_time - newest_ns) > FAR_NS else log_time
