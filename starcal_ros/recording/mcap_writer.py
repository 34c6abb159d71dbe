# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""MCAP written chunk by chunk, single messages or whole arrays of them.

Messages go into zstd-compressed chunks with a checksum and a message index. A chunk ends with
the second of log time in which it began (or with some of them, where nobody waits for it), or
earlier when it is full, and is handed to the operating system at once: a process that is killed
loses its last second, no more. One that can not
be written whole is taken back, so that the file ends with the chunk before.

All that stands before the summary has a checksum of its own, and the summary another.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
import struct
from typing import BinaryIO
import zlib

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (Attachment, AttachmentIndex, Channel, Chunk, ChunkIndex, DataEnd, Footer,
                          Header, McapRecord, Metadata, MetadataIndex, Schema, Statistics,
                          SummaryOffset)
import numpy as np
from numpy.typing import NDArray
import zstandard

from starcal_ros.core.arrays import Ints
from starcal_ros.recording.mcap_chunk import MESSAGE_HEAD, RECORD
from starcal_ros.recording.mcap_index import ChunkIndices
from starcal_ros.recording.mcap_reader import MAGIC

CHUNK_BYTES = 1 << 20

_HEAD = struct.Struct('<BQHIQQ')


class McapWriter:
    """The records of one MCAP file.

    Parameters
    ----------
    stream : binary file
        Where to write, from its start, unbuffered; left open by `finish`.
    profile, library : str
        Named in the header of the file.
    chunk_s : int
        Seconds of log time in a chunk, at most.
    """

    def __init__(self, stream: BinaryIO, profile: str, library: str, chunk_s: int = 1) -> None:
        self._stream, self._chunk_ns = stream, chunk_s * 10**9
        self._position, self._crc = 0, 0
        self._zstd = zstandard.ZstdCompressor()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunk_indices = ChunkIndices()
        self._attachment_indices: list[AttachmentIndex] = []
        self._metadata_indices: list[MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._records = bytearray()
        self._index: dict[int, array[int]] = {}
        self._slot: int | None = None
        self._write([MAGIC, _encode(Header(profile, library))])

    def slot(self, log_time_ns: Ints | int) -> Ints | int:
        """Return a number for the seconds of log time that share a chunk."""
        return log_time_ns // self._chunk_ns

    @property
    def n_bytes(self) -> int:
        """Length of the file so far, without what is pending."""
        return self._position

    @property
    def n_chunks(self) -> int:
        """Number of chunks that are written."""
        return self._chunk_indices.count

    @property
    def counts(self) -> Counter[int]:
        """Number of messages by channel, pending ones included."""
        return self._counts.copy()

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last log time in the chunks that are written, None without any."""
        return self._chunk_indices.span_ns

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

    def declare(self, schemas: Iterable[Schema], channels: Iterable[Channel]) -> None:
        """Declare types and topics of another file, with their ids, before its chunks."""
        self._schemas += schemas
        self._channels += channels
        self._write(_all([*self._schemas, *self._channels]))

    def add_chunk(self, raw: bytes | memoryview, packed: bytes | memoryview, compression: str,
                  index: Mapping[int, NDArray[np.uint64]]) -> None:
        """Write a chunk of another file as it is, all topics of which are declared.

        Parameters
        ----------
        raw, packed : bytes
            Its records, and the same compressed.
        compression : str
            '', 'lz4' or 'zstd'.
        index : dict of (n, 2) array
            By channel: the log time and the place of each message.
        """
        self.finish_chunk()
        self._write_chunk(raw, packed, compression, {
            channel: entries.tobytes() for channel, entries in index.items() if len(entries)})
        self._counts.update({channel: len(entries) for channel, entries in index.items()})

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
        """Write messages of equal length that belong into one chunk (`slot`) by their log time.

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
        index = AttachmentIndex(
            self._position, len(record), time_ns, time_ns, len(data), name, media_type)
        self._write([record])
        self._attachment_indices.append(index)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a record of texts by names; of several with one name the last one holds."""
        record = _encode(Metadata(name=name, metadata=values))
        index = MetadataIndex(offset=self._position, length=len(record), name=name)
        self._write([record])
        self._metadata_indices.append(index)

    def finish_chunk(self) -> None:
        """Write the messages so far to the file.

        Raises
        ------
        OSError
            Where there is no room: the messages are lost, and the file ends before them.
        """
        if not self._index:
            return
        try:
            self._write_chunk(self._records, self._zstd.compress(self._records), 'zstd', {
                channel: entries.tobytes() for channel, entries in self._index.items()})
        except OSError:
            self._counts.subtract({channel: len(entries) // 2
                                   for channel, entries in self._index.items()})
            raise
        finally:
            self._records.clear()
            self._index.clear()
            self._slot = None

    def _write_chunk(self, raw: bytes | bytearray | memoryview, packed: bytes | memoryview,
                     compression: str, index: Mapping[int, bytes]) -> None:
        log_times = np.frombuffer(b''.join(index.values()), np.uint64)[::2]
        low, high = int(log_times.min()), int(log_times.max())
        record = _encode(Chunk(compression, bytes(packed), high, low, zlib.crc32(raw), len(raw)))
        after, offsets = b'', {}
        for channel, entries in index.items():
            offsets[channel] = self._position + len(record) + len(after)
            after += struct.pack('<BQHI', Opcode.MESSAGE_INDEX, 6 + len(entries), channel,
                                 len(entries)) + entries
        chunk = ChunkIndex(len(record), self._position, compression, len(packed), high,
                           len(after), offsets, low, len(raw))
        self._write([record, after])
        self._chunk_indices.add(_encode(chunk), low, high)

    def finish(self) -> None:
        """Write the last chunk, the summary and the end of the file.

        Raises
        ------
        OSError
            Where there is no room; the file then ends with its last chunk that is whole.
        """
        self.finish_chunk()
        data_end = _encode(DataEnd(self._crc))
        start = self._position + len(data_end)
        groups: list[tuple[Opcode, list[bytes] | ChunkIndices]] = [
            (Opcode.SCHEMA, _all(self._schemas)), (Opcode.CHANNEL, _all(self._channels)),
            (Opcode.STATISTICS, _all([self._statistics()])),
            (Opcode.CHUNK_INDEX, self._chunk_indices),
            (Opcode.ATTACHMENT_INDEX, _all(self._attachment_indices)),
            (Opcode.METADATA_INDEX, _all(self._metadata_indices))]
        offsets, end = b'', start
        for opcode, records in groups:
            size = (records.n_bytes if isinstance(records, ChunkIndices) else
                    sum(map(len, records)))
            if size:
                offsets += _encode(SummaryOffset(opcode, end, size))
            end += size
        footer = _encode(Footer(start, end, 0))[:-4]
        summary = chain(*(records for _, records in groups), [offsets + footer])
        self._write([data_end], _checked(summary), [MAGIC])

    def _make_room(self, log_time_ns: int) -> None:
        """Begin a new chunk where the last one is full or of other seconds."""
        slot = int(self.slot(log_time_ns))
        if slot != self._slot or len(self._records) >= CHUNK_BYTES:
            self.finish_chunk()
            self._slot = slot

    def _entries(self, channel: int) -> array[int]:
        """Return the message index of a channel: log time, offset, log time, offset..."""
        if channel not in self._index:
            self._index[channel] = array('Q')
        return self._index[channel]

    def _statistics(self) -> Statistics:
        first_ns, last_ns = self._chunk_indices.span_ns or (0, 0)
        return Statistics(
            attachment_count=len(self._attachment_indices), channel_count=len(self._channels),
            channel_message_counts=self._counts, chunk_count=self._chunk_indices.count,
            message_count=self._counts.total(),
            message_end_time=last_ns, message_start_time=first_ns,
            metadata_count=len(self._metadata_indices), schema_count=len(self._schemas))

    def _write(self, *groups: Iterable[bytes]) -> None:
        """Write pieces whole, or leave the file as it was and raise OSError."""
        position, crc = self._position, self._crc
        try:
            for piece in chain(*groups):
                rest = memoryview(piece)
                while rest:
                    rest = rest[self._stream.write(rest):]
                position += len(piece)
                crc = zlib.crc32(piece, crc)
        except OSError:
            self._stream.truncate(self._position)
            self._stream.seek(self._position)
            raise
        self._position, self._crc = position, crc


def _checked(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Give pieces, and after them their checksum."""
    crc = 0
    for piece in pieces:
        crc = zlib.crc32(piece, crc)
        yield piece
    yield struct.pack('<I', crc)


def _all(records: Sequence[McapRecord]) -> list[bytes]:
    return [*map(_encode, records)]


def _encode(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
