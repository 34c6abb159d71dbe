# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The chunk index of an MCAP file while it is written: small, however long that takes.

It stands in the summary, at the end of the file, so that all of it has to be kept until then. Its
records differ by little from each other: compressed, a chunk takes some tens of bytes.
"""

from __future__ import annotations

from collections.abc import Iterator

import zstandard

_BLOCK = 1 << 16        # bytes that are compressed together


class ChunkIndices:
    """Encoded records, in their order.

    Attributes
    ----------
    count : int
        Number of records.
    n_bytes : int
        Length of all [bytes].
    span_ns : (int, int) or None
        First and last log time of the chunks, None without any.
    """

    def __init__(self) -> None:
        self.count = self.n_bytes = 0
        self.span_ns: tuple[int, int] | None = None
        self._packed: list[bytes] = []
        self._rest = bytearray()

    def add(self, record: bytes, first_ns: int, last_ns: int) -> None:
        """Take the record of a chunk, and its first and last log time."""
        self.count += 1
        self.n_bytes += len(record)
        low, high = self.span_ns or (first_ns, last_ns)
        self.span_ns = min(low, first_ns), max(high, last_ns)
        self._rest += record
        if len(self._rest) >= _BLOCK:
            # A copy: what the compressor gives has room for what does not compress.
            self._packed.append(bytes(memoryview(zstandard.compress(self._rest))))
            self._rest.clear()

    def __iter__(self) -> Iterator[bytes]:
        """Give the records, many at a time."""
        yield from map(zstandard.decompress, self._packed)
        yield bytes(self._rest)
