# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The gyro readings that are still needed, at a constant cost a reading."""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Ints
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.measurements.timeline import NEVER_NS

_ROOM = 1024            # readings, at least


class GyroBuffer:
    """Readings in the order of their stamps, forgotten from the front.

    They lie in arrays with room behind them. Where the room is used up, what is still needed moves
    to new arrays of at least twice its size, so that a reading is moved once on average, however
    many are kept; what `since` has given stays as it is.
    """

    def __init__(self) -> None:
        self._stamp_ns: Ints = np.empty(_ROOM, np.int64)
        self._rate = np.empty((_ROOM, 3))
        self._begin = self._end = 0

    def __len__(self) -> int:
        return self._end - self._begin

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest reading; NEVER_NS where there is none."""
        return int(self._stamp_ns[self._end - 1]) if len(self) else NEVER_NS

    def add(self, samples: GyroSamples) -> None:
        """Take readings that are newer than those before, with increasing stamps."""
        end = self._end + len(samples)
        if end > len(self._stamp_ns):
            kept, end = self.everything, len(self) + len(samples)
            room = max(_ROOM, 2 * end)
            self._stamp_ns, self._rate = np.empty(room, np.int64), np.empty((room, 3))
            self._stamp_ns[:len(kept)], self._rate[:len(kept)] = kept.stamp_ns, kept.rate
            self._begin, self._end = 0, len(kept)
        self._stamp_ns[self._end:end], self._rate[self._end:end] = samples.stamp_ns, samples.rate
        self._end = end

    @property
    def everything(self) -> GyroSamples:
        """All readings that are kept; a view."""
        rows = slice(self._begin, self._end)
        return GyroSamples(self._stamp_ns[rows], self._rate[rows])

    def since(self, stamp_ns: int) -> GyroSamples:
        """Return the readings that cover the time since a stamp; a view.

        The reading at or before the stamp is the first: the next one begins where it ends.
        """
        return self.everything[self._row(stamp_ns):]

    def reaches(self, stamp_ns: int) -> bool:
        """Tell whether the readings cover the time up to a stamp."""
        return self.newest_ns >= stamp_ns

    def forget_before(self, stamp_ns: int) -> int:
        """Forget what `since` would not give for this stamp or a later one; return how much."""
        forgotten = self._row(stamp_ns)
        self._begin += forgotten
        return forgotten

    def keep_last(self, duration_ns: int) -> int:
        """Forget what is older than the newest reading by more than a time; return how much."""
        return self.forget_before(self.newest_ns - duration_ns) if len(self) else 0

    def clear(self) -> None:
        """Forget all readings."""
        self._begin = self._end

    def _row(self, stamp_ns: int) -> int:
        stamps = self._stamp_ns[self._begin:self._end]
        return max(int(np.searchsorted(stamps, stamp_ns, side='right')) - 1, 0)
