# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One chunk of an MCAP file: decompressed, scanned, and its messages located as arrays.

A chunk is a sequence of records (opcode u1, length u8, content), most often compressed. The
message index that follows it in the file gives the log time and the place of each message.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
import struct
import zlib

import lz4.frame  # type: ignore[import-untyped]
from mcap.opcode import Opcode
import numpy as np
from numpy.typing import NDArray
import zstandard

from starcal_ros.core.arrays import Ints
from starcal_ros.files.limits import CHUNK, LimitError
from starcal_ros.messages.cdr import Messages, RecordError, gather

MESSAGE_HEAD = np.dtype([('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'),
                         ('sequence', '<u4'), ('log_time', '<u8'), ('publish_time', '<u8')])
RECORD = struct.Struct('<BQ')
NO_ENTRIES = np.empty((0, 2), np.uint64)

_CHUNK = struct.Struct('<QQQII')
_MESSAGE = struct.Struct('<HIQ')
_BEYOND = np.uint64(2**62)
_ZSTD = zstandard.ZstdDecompressor()
ZSTD_HEAD = 18        # bytes, the longest head of a frame
_DECLARATIONS = (Opcode.SCHEMA, Opcode.CHANNEL)

Index = dict[int, NDArray[np.uint64]]
"""For each channel id, (n, 2): the log time [ns] and the offset of each message."""


@dataclass
class Chunk:
    """A chunk, still compressed.

    Attributes
    ----------
    offset : int
        Where its record starts in the file [bytes].
    size, crc : int
        Uncompressed size [bytes] and CRC-32; a CRC of 0 is none.
    compression : str
        '', 'lz4' or 'zstd'.
    packed : memoryview
        The compressed bytes.
    index : Index
        Its messages; empty where the file has no index.
    first_ns, last_ns : int
        Log times that it names as its least and greatest.
    """

    offset: int
    size: int
    crc: int
    compression: str
    packed: memoryview
    index: Index
    first_ns: int = 0
    last_ns: int = 0

    @classmethod
    def parse(cls, offset: int, content: memoryview) -> Chunk:
        """Parse the content of a chunk record; struct.error or ValueError if it is garbled."""
        first_ns, last_ns, size, crc, length = _CHUNK.unpack_from(content)
        position = _CHUNK.size + length
        compression = str(content[_CHUNK.size:position], 'utf-8')
        (n_packed,) = struct.unpack_from('<Q', content, position)
        packed = content[position + 8:position + 8 + n_packed]
        return cls(offset, size, crc, compression, packed, {}, first_ns, last_ns)

    @property
    def room(self) -> int:
        """Bytes that its records take, at most: a size that is not believed takes none."""
        return self.size if self.size <= max(len(self.packed), CHUNK.value) else 0

    def decompress(self) -> bytes | memoryview:
        """Return the records of the chunk; RecordError if they cannot be trusted."""
        raw: bytes | memoryview = self.packed
        try:
            if self.compression:
                raw = unpack(self.compression, self.packed, self.size)
        except LimitError as error:
            raise RecordError(str(error)) from None
        except (zstandard.ZstdError, RuntimeError, MemoryError):
            raise RecordError(f'its {self.compression} data are damaged') from None
        if len(raw) != self.size:
            raise RecordError(f'it holds {len(raw)} bytes, not {self.size}')
        if self.crc and zlib.crc32(raw) != self.crc:
            raise RecordError('its checksum is wrong')
        return raw


def unpack(compression: str, packed: bytes | memoryview, size: int) -> bytes:
    """Decompress data that are said to have a size, and to no more than that.

    The size is checked against the limit before any memory is taken for it, and what the data say
    of themselves against the size: neither is to be believed.

    Raises
    ------
    LimitError
        Where the size, or what comes out, is too large.
    ZstdError, RuntimeError
        Where the data are damaged.
    """
    CHUNK.check(size, f'{compression} data')
    if compression == 'zstd':
        stated = zstandard.get_frame_parameters(packed[:ZSTD_HEAD]).content_size
        if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise LimitError(f'{stated} bytes by its data, {size} by its record')
        return bytes(_ZSTD.decompress(packed, max_output_size=size))
    if compression == 'lz4':
        stream = lz4.frame.LZ4FrameDecompressor()
        raw: bytes = stream.decompress(packed, max_length=size + 1)
        if len(raw) > size:
            raise LimitError(f'more than the {size} bytes of its record')
        if not stream.eof:
            raise RuntimeError('incomplete')
        return raw
    raise RecordError(f"compression '{compression}' is not one of zstd and lz4")


def scan(raw: bytes | memoryview) -> tuple[Index, list[tuple[int, bytes | memoryview]]]:
    """Go from record to record over a decompressed chunk, up to its end or a broken record.

    What is kept takes no more memory than the chunk does, whatever its records are.

    Returns
    -------
    index : Index
        Where the messages are.
    others : list of (opcode, content)
        Schemas and channels, of each id the last.
    """
    entries: dict[int, array[int]] = {}
    others: dict[bytes, tuple[int, bytes | memoryview]] = {}
    position = 0
    while position + RECORD.size <= len(raw):
        opcode, length = RECORD.unpack_from(raw, position)
        content = position + RECORD.size
        if content + length > len(raw) or opcode == 0:
            break
        if opcode in _DECLARATIONS:
            key = bytes([opcode]) + bytes(raw[content:content + min(length, 2)])
            others[key] = opcode, raw[content:content + length]
        elif opcode == Opcode.MESSAGE and length >= MESSAGE_HEAD.itemsize - RECORD.size:
            channel, _, log_time = _MESSAGE.unpack_from(raw, content)
            if channel not in entries:
                entries[channel] = array('Q')
            entries[channel].extend((log_time, position))
        position = content + length
    return {channel: np.frombuffer(pairs, np.uint64).reshape(-1, 2)
            for channel, pairs in entries.items()}, [*others.values()]


def locate(channel: int, indices: Sequence[Index], data: NDArray[np.uint8],
           edges: Ints) -> tuple[Ints, Messages] | None:
    """Find the messages of a channel in decompressed chunks.

    Parameters
    ----------
    channel : int
        Id of the channel.
    indices : n of Index
        The index of each chunk.
    data : (n_bytes,) uint8 array
        The chunks, end to end.
    edges : (n + 1,) int64 array
        Where each starts, and the end [bytes].

    Returns
    -------
    (log_time, messages) or None
        Log times (m,) [ns] and the messages; None where an index does not fit its chunk.
    """
    entries = [index.get(channel, NO_ENTRIES) for index in indices]
    counts = [len(rows) for rows in entries]
    low, high = np.repeat(edges[:-1], counts), np.repeat(edges[1:], counts)
    offset = np.concatenate([NO_ENTRIES, *entries])[:, 1]
    start = low + np.minimum(offset, _BEYOND).astype(np.int64)
    if (start + MESSAGE_HEAD.itemsize > high).any():
        return None
    head = gather(data, start, MESSAGE_HEAD)
    size = np.minimum(head['length'], _BEYOND).astype(np.int64) + RECORD.size
    if not ((head['opcode'] == Opcode.MESSAGE) & (head['channel'] == channel)
            & (size >= MESSAGE_HEAD.itemsize) & (start + size <= high)).all():
        return None
    if size.sum() > len(data):      # messages do not overlap: one that is named twice is none
        return None
    return head['log_time'].astype(np.int64), Messages(
        data, start + MESSAGE_HEAD.itemsize, size - MESSAGE_HEAD.itemsize)
