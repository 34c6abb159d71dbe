# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""MCAP written chunk by chunk, single messages or whole arrays of them.

Messages go into zstd-compressed chunks with a checksum and a message index. A chunk ends with
the second of log time in which it began, or earlier when it is full, and is handed to the
operating system at once: a process that is killed loses its last second, no more.
"""

from __future__ import annotations

from array import array
from collections import Counter
import struct
from typing import BinaryIO
import zlib

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (Attachment, AttachmentIndex, Channel, Chunk, ChunkIndex, DataEnd, Footer,
                          Header, McapRecord, Schema, Statistics, SummaryOffset)
import numpy as np
from numpy.typing import NDArray
import zstandard

from starcal_ros.core.arrays import Ints
from starcal_ros.recording.mcap_chunk import MESSAGE_HEAD, RECORD
from starcal_ros.recording.mcap_reader import MAGIC

CHUNK_NS = 10**9
CHUNK_BYTES = 1 << 20

_HEAD = struct.Struct('<BQHIQQ')


class McapWriter:
    """The records of one MCAP file.

    Parameters
    ----------
    stream : binary file
        Where to write, from its start; left open by `finish`.
    profile, library : str
        Named in the header of the file.
    """

    def __init__(self, stream: BinaryIO, profile: str, library: str) -> None:
        self._stream = stream
        self._position = 0
        self._zstd = zstandard.ZstdCompressor()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunk_indices: list[ChunkIndex] = []
        self._attachment_indices: list[AttachmentIndex] = []
        self._counts: Counter[int] = Counter()
        self._records = bytearray()
        self._index: dict[int, array[int]] = {}
        self._second: int | None = None
        self._write(MAGIC)
        self._write(_encode(Header(profile, library)))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a type and return its id."""
        self._schemas.append(Schema(len(self._schemas) + 1, data, encoding, name))
        self._records += _encode(self._schemas[-1])
        return self._schemas[-1].id

    def add_channel(self, topic: str, encoding: str, schema_id: int,
                    metadata: dict[str, str]) -> int:
        """Declare a topic and return its id."""
        self._channels.append(
            Channel(len(self._channels) + 1, topic, encoding, metadata, schema_id))
        self._records += _encode(self._channels[-1])
        return self._channels[-1].id

    def add_message(self, channel: int, log_time_ns: int, publish_time_ns: int,
                    data: bytes | memoryview) -> None:
        """Write one message."""
        self._make_room(log_time_ns)
        self._entries(channel).extend((log_time_ns, len(self._records)))
        self._records += _HEAD.pack(Opcode.MESSAGE, len(data) + _HEAD.size - RECORD.size, channel,
                                    self._counts[channel], log_time_ns, publish_time_ns)
        self._records += data
        self._counts[channel] += 1

    def add_rows(self, channel: int, log_time_ns: Ints,
                 rows: NDArray[np.uint8]) -> None:
        """Write messages of equal length that belong to one second of log time.

        Parameters
        ----------
        channel : int
            Their channel.
        log_time_ns : (n,) int64 array
            When they were recorded, and published.
        rows : (n, size) uint8 array
            One message a row.
        """
        n, size = rows.shape
        self._make_room(int(log_time_ns[0]))
        head = np.empty(n, MESSAGE_HEAD)
        head['opcode'], head['length'] = Opcode.MESSAGE, size + _HEAD.size - RECORD.size
        head['channel'] = channel
        head['sequence'] = self._counts[channel] + np.arange(n)
        head['log_time'] = head['publish_time'] = log_time_ns
        records = np.hstack((head.view(np.uint8).reshape(n, _HEAD.size), rows))
        entries = np.empty((n, 2), np.uint64)
        entries[:, 0] = log_time_ns
        entries[:, 1] = len(self._records) + np.arange(n) * records.shape[1]
        self._entries(channel).frombytes(entries.tobytes())
        self._records += records.tobytes()
        self._counts[channel] += n

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Attach a file, made and recorded at a time."""
        record = _encode(Attachment(time_ns, time_ns, name, media_type, data))
        self._attachment_indices.append(AttachmentIndex(
            self._position, len(record), time_ns, time_ns, len(data), name, media_type))
        self._write(record)
        self._stream.flush()

    def finish_chunk(self) -> None:
        """Write the messages so far to the file."""
        if not self._index:
            return
        log_times = np.concatenate([np.frombuffer(entries, np.uint64)[::2]
                                    for entries in self._index.values()])
        low, high = int(log_times.min()), int(log_times.max())
        packed = self._zstd.compress(self._records)
        record = _encode(Chunk('zstd', packed, high, low, zlib.crc32(self._records),
                               len(self._records)))
        offset = self._position
        self._write(record)
        index_offsets = {}
        for channel, entries in self._index.items():
            index_offsets[channel] = self._position
            self._write(struct.pack('<BQHI', Opcode.MESSAGE_INDEX, 6 + 8 * len(entries), channel,
                                    8 * len(entries)) + entries.tobytes())
        self._chunk_indices.append(ChunkIndex(
            len(record), offset, 'zstd', len(packed), high,
            self._position - offset - len(record), index_offsets, low, len(self._records)))
        self._stream.flush()
        self._records.clear()
        self._index.clear()
        self._second = None

    def finish(self) -> None:
        """Write the last chunk, the summary and the end of the file."""
        self.finish_chunk()
        self._write(_encode(DataEnd(0)))
        start = self._position
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*self._schemas]), (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self._chunk_indices]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachment_indices])]
        summary, offsets = b'', b''
        for opcode, records in groups:
            group = b''.join(_encode(record) for record in records)
            if group:
                offsets += _encode(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        footer = _encode(Footer(start, start + len(summary), 0))[:-4]
        crc = zlib.crc32(summary + offsets + footer)
        self._write(summary + offsets + footer + struct.pack('<I', crc) + MAGIC)
        self._stream.flush()

    def _make_room(self, log_time_ns: int) -> None:
        """Begin a new chunk where the last one is full or of another second."""
        second = log_time_ns // CHUNK_NS
        if second != self._second or len(self._records) >= CHUNK_BYTES:
            self.finish_chunk()
            self._second = second

    def _entries(self, channel: int) -> array[int]:
        """Return the message index of a channel: log time, offset, log time, offset..."""
        if channel not in self._index:
            self._index[channel] = array('Q')
        return self._index[channel]

    def _statistics(self) -> Statistics:
        chunks = self._chunk_indices
        return Statistics(
            attachment_count=len(self._attachment_indices), channel_count=len(self._channels),
            channel_message_counts=self._counts, chunk_count=len(chunks),
            message_count=self._counts.total(),
            message_end_time=max((chunk.message_end_time for chunk in chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in chunks), default=0),
            metadata_count=0, schema_count=len(self._schemas))

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self._position += len(data)


def _encode(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
