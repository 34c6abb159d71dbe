# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The chunks of an MCAP file, as places in it: each is parsed when it is asked for.

A day has 86,400 chunks of a second, and a chunk with its index takes kilobytes once it is parsed;
its place and its times take 34 bytes. The topics of neighbouring chunks are the same most of the
time: each set of them is kept once.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
import struct

from mcap.opcode import Opcode
import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.arrays import Ints
from starcal_ros.recording.mcap_chunk import RECORD, Chunk, Index

_HEAD = struct.Struct('<HI')        # of a message index
_MOST_KINDS = 65_000

LATEST = 2**63 - 1
"""Later than any message [ns]."""

Entries = NDArray[np.uint64]
"""(n, 2): log times and offsets, as in `mcap_chunk.Index`."""


class Chunks:
    """The chunks of a file, in its order.

    Parameters
    ----------
    view : memoryview
        The file.

    Attributes
    ----------
    counts : Counter
        Messages of each channel, by the indices.
    """

    def __init__(self, view: memoryview) -> None:
        self._view = view
        self._offsets, self._ends = array('Q'), array('Q')      # of a chunk, and of its index
        self._times = array('q')                                # first and last log time of each
        self._kinds = array('H')                                # its channels
        self._sets: list[frozenset[int]] = [frozenset()]
        self._known = {self._sets[0]: 0}
        self._given: dict[int, Index] = {}                      # where the file's own is none
        self._loose: Chunk | None = None
        self._open: dict[int, Entries] = {}                     # index of the last chunk
        self.counts: Counter[int] = Counter()

    def __len__(self) -> int:
        return len(self._offsets) + (self._loose is not None)

    def __iter__(self) -> Iterator[Chunk]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, k: int) -> Chunk:
        """Return a chunk with its index, as it is now."""
        return self.chunk(k)

    def chunk(self, k: int, channels: Collection[int] | None = None) -> Chunk:
        """Return a chunk with the index of some channels."""
        if k == len(self._offsets) and self._loose is not None:
            chunk = self._loose
        else:
            chunk = Chunk.parse(self._offsets[k], self._content(self._offsets[k]))
        chunk.index = self._given[k] if k in self._given else self._parse_index(k, channels)
        return chunk

    def add(self, position: int, content: memoryview) -> None:
        """Take a chunk; struct.error or ValueError if it is garbled."""
        chunk = Chunk.parse(position, content)
        self._close()
        self._times.extend((min(chunk.first_ns, LATEST), min(chunk.last_ns, LATEST)))
        self._offsets.append(position)
        self._ends.append(position + RECORD.size + len(content))
        self._kinds.append(0)

    def add_index(self, position: int, content: memoryview) -> None:
        """Take a part of the index of the last chunk; struct.error or ValueError if garbled."""
        if not self._offsets or len(self._offsets) - 1 in self._given:
            return
        channel, length = _HEAD.unpack_from(content)
        self._open[channel] = _entries(content, length)
        self._ends[-1] = position + RECORD.size + len(content)

    def drop_index(self) -> None:
        """Believe nothing of the index of the last chunk."""
        self._open.clear()
        if self._offsets:
            self._given[len(self._offsets) - 1] = {}

    def finish(self, loose: memoryview | None) -> None:
        """End the file; messages outside of chunks make one of their own."""
        self._close()
        if loose is not None:
            self._loose = Chunk(0, len(loose), 0, '', loose, {})
            self._times.extend((0, 0))
            self._given[len(self._offsets)] = {}
            self._kinds.append(0)

    def channels(self, k: int) -> frozenset[int]:
        """Return what the index of a chunk names; nothing without one."""
        return self._sets[self._kinds[k]]

    def set_index(self, k: int, index: Index) -> None:
        """Give a chunk another index."""
        before = self[k].index
        self.counts.subtract({channel: len(entries) for channel, entries in before.items()})
        self.counts.update({channel: len(entries) for channel, entries in index.items()})
        self._given[k] = index
        self._kinds[k] = self._kind(index.keys())
        if index:
            low, high = _limits(index)
            self._times[2 * k:2 * k + 2] = array('q', (min(low, LATEST), min(high, LATEST)))

    def holding(self, channels: Collection[int]) -> tuple[Ints, Ints, Ints]:
        """Return the chunks with messages of some channels, and the times that they reach over.

        Returns
        -------
        chunk : (n,) int64 array
            Their numbers, in the order of the file.
        first_ns, last_ns : (n,) int64 array
            Least and greatest log time of all that is in each.
        """
        kinds = [kind for kind, held in enumerate(self._sets) if not held.isdisjoint(channels)]
        chunk = np.flatnonzero(np.isin(np.array(self._kinds), kinds)).astype(np.int64)
        times = np.array(self._times, np.int64).reshape(-1, 2)[chunk]
        return chunk, times[:, 0], times[:, 1]

    def _close(self) -> None:
        """Take the index of the last chunk as complete, where it is of the times of its head."""
        if not self._open:
            return
        last = len(self._offsets) - 1
        outer = {channel: entries[[0, -1]] for channel, entries in self._open.items()
                 if len(entries)}
        first_ns, last_ns = self._times[-2:]
        if outer and not first_ns <= _limits(outer)[0] <= _limits(outer)[1] <= last_ns:
            self._given[last] = {}
        else:
            self.counts.update({channel: len(entries) for channel, entries in self._open.items()})
            self._kinds[last] = self._kind(self._open.keys())
        self._open.clear()

    def _kind(self, channels: Collection[int]) -> int:
        found = frozenset(channels)
        if found not in self._known:
            if len(self._sets) > _MOST_KINDS:       # no recording: it is scanned each time
                return 0
            self._known[found] = len(self._sets)
            self._sets.append(found)
        return self._known[found]

    def _content(self, position: int) -> memoryview:
        _, length = RECORD.unpack_from(self._view, position)
        begin = position + RECORD.size
        return self._view[begin:begin + length]

    def _parse_index(self, k: int, channels: Collection[int] | None) -> Index:
        index: Index = {}
        _, length = RECORD.unpack_from(self._view, self._offsets[k])
        position = self._offsets[k] + RECORD.size + length
        while position < self._ends[k]:
            opcode, length = RECORD.unpack_from(self._view, position)
            if opcode == Opcode.MESSAGE_INDEX:
                content = self._content(position)
                with suppress(struct.error, ValueError):    # as it was left out before
                    channel, size = _HEAD.unpack_from(content)
                    if channels is None or channel in channels:
                        index[channel] = _entries(content, size)
            position += RECORD.size + length
        return index


def _limits(index: Mapping[int, Entries]) -> tuple[int, int]:
    """Return the least and the greatest log time."""
    times = np.concatenate([entries[:, 0] for entries in index.values()])
    return int(times.min()), int(times.max())


def _entries(content: memoryview, length: int) -> Entries:
    return np.frombuffer(content[_HEAD.size:_HEAD.size + length], '<u8').reshape(-1, 2)
