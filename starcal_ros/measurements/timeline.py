# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The messages of one topic on a clock that only goes forward, or is set back and begins again.

A stamp alone may be wrong; what follows tells. With n the newest stamp that is believed, a
message stamped s ::

    n < s <= n + leap   is believed
    s > n + leap        is held, and believed when the next one is newer still; when the next one
                        goes on from n instead, it was wrong and is dropped. The first message of
                        all is such a one.
    s <= n              is late or a duplicate, and dropped. When those that follow go on from it,
                        in order and for a while (SET_BACK_S), the clock was set back, as by a
                        recording that is played again: they begin a new stretch.

So one wrong stamp costs one message, a silence delays one message until the next, and a second
or two that are sent again change nothing. What becomes of a message depends on the messages of
its own topic alone, not on how they were cut into batches.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from starcal_ros.core.arrays import Ints

SET_BACK_S = 3.0
"""Time that messages must go on in the past before the clock counts as set back [s]."""

NEVER_NS = int(np.iinfo(np.int64).min)


class Stamped(Protocol):
    """Messages in the order of their arrival: `GyroSamples` or `Frames`."""

    @property
    def stamp_ns(self) -> Ints:
        """Stamps, (n,)."""

    def __len__(self) -> int: ...

    def __getitem__(self: M, rows: slice, /) -> M: ...


M = TypeVar('M', bound=Stamped)


class Dropped(NamedTuple):
    """Messages that were dropped together.

    Attributes
    ----------
    number : int
        How many.
    stamp_ns : int
        Stamp of the first.
    ahead : bool
        Ahead of those that followed; else not newer than those before.
    """

    number: int
    stamp_ns: int
    ahead: bool


class Timeline(Generic[M]):
    """Sorts the messages of one topic into stretches of increasing stamps.

    Parameters
    ----------
    period_ns : float
        Nominal time between two messages.
    kept : int
        Messages of later stretches that are kept, at most.
    leap_periods : float
        Periods that may pass without a message and arouse no suspicion.

    Attributes
    ----------
    end_ns : int
        Newest stamp of the current stretch.
    later : deque of lists
        Messages of the stretches after the current one.
    """

    def __init__(self, period_ns: float, kept: int, leap_periods: float) -> None:
        self.end_ns = NEVER_NS
        self.later: deque[list[M]] = deque()
        self._leap_ns = round(leap_periods * period_ns)
        self._set_back_ns = max(round(SET_BACK_S * 1e9), self._leap_ns)
        self._kept = kept
        self._newest_ns = NEVER_NS          # of the last stretch
        self._held: list[M] = []            # messages whose stamps are not believed yet
        self._dropped: list[Dropped] = []

    def add(self, messages: M) -> list[M]:
        """Take messages as they arrived and return those that go on in the current stretch."""
        current: list[M] = []
        for part, begins in self._sorted(messages):
            self._newest_ns = int(part.stamp_ns[-1])
            if begins:
                self.later.append([])
            if self.later:
                self.later[-1].append(part)
                self._forget()
            else:
                current.append(part)
                self.end_ns = self._newest_ns
        return current

    def take_dropped(self) -> list[Dropped]:
        """Return what was dropped since the last call."""
        dropped, self._dropped = self._dropped, []
        return dropped

    @property
    def overtaken_ns(self) -> int | None:
        """First stamp of the next stretch that is newer than the current one, if it has one."""
        for part in self.later[0] if self.later else ():
            row = int(np.searchsorted(part.stamp_ns, self.end_ns, side='right'))
            if row < len(part):
                return int(part.stamp_ns[row])
        return None

    def begin_next(self) -> list[M]:
        """Make the next stretch the current one and return its messages so far."""
        parts = self.later.popleft()
        self.end_ns = int(parts[-1].stamp_ns[-1])
        return parts

    def rejoin(self) -> list[M]:
        """Make the next stretch part of the current one; return its messages that are newer."""
        before_ns, current = self.end_ns, []
        for part in self.begin_next():
            row = int(np.searchsorted(part.stamp_ns, before_ns, side='right'))
            self._drop(part[:row])
            current += [part[row:]] if row < len(part) else []
        return current

    def _sorted(self, messages: M) -> Iterator[tuple[M, bool]]:
        """Yield messages that are believed, and whether a stretch begins with them."""
        step = messages.stamp_ns[1:] - messages.stamp_ns[:-1]       # np.diff takes ten times that
        edges = np.flatnonzero((step <= 0) | (step > self._leap_ns)) + 1
        bounds = [0, *edges.tolist(), len(messages)]
        for low, high in zip(bounds[:-1], bounds[1:]):
            part = messages[low:high]
            while len(part):
                part = yield from self._judge(part)

    def _judge(self, part: M) -> Generator[tuple[M, bool], None, M]:
        """Judge the first of messages in close order, and what shares its lot; return the rest."""
        stamps, newest = part.stamp_ns, self._newest_ns
        first = int(stamps[0])
        begun, reached = ((int(self._held[0].stamp_ns[0]), int(self._held[-1].stamp_ns[-1]))
                          if self._held else (NEVER_NS, NEVER_NS))
        past = int(np.searchsorted(stamps, newest, side='right'))
        if newest < first <= newest + self._leap_ns:
            self._let_go()
            yield part, False
            return part[:0]
        if self._held and begun > newest and first > reached:
            yield from ((held, False) for held in self._take_held())
            return part
        if self._held and begun <= newest and reached < first <= newest:
            if int(stamps[past - 1]) - begun < self._set_back_ns:
                self._held.append(part[:past])
                return part[past:]
            for k, held in enumerate([*self._take_held(), part]):
                yield held, k == 0
            return part[:0]
        if begun <= first <= reached or newest - self._set_back_ns < first <= newest:
            until = reached if begun <= first <= reached else newest
            row = int(np.searchsorted(stamps, until, side='right'))
            self._drop(part[:row])
            return part[row:]
        self._let_go()
        self._held = [part[:1]]
        return part[1:]

    def _take_held(self) -> list[M]:
        held, self._held = self._held, []
        return held

    def _let_go(self) -> None:
        for held in self._take_held():
            self._drop(held)

    def _drop(self, part: M) -> None:
        if len(part):
            first = int(part.stamp_ns[0])
            self._dropped.append(Dropped(len(part), first, first > self._newest_ns))

    def _forget(self) -> None:
        excess = sum(len(part) for parts in self.later for part in parts) - self._kept
        for parts in self.later:
            while excess > 0 and len(parts) > 1:
                excess -= len(parts[0])
                self._drop(parts.pop(0))
