# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, read as whole chunks: the messages of a channel come as arrays.

Chunks are decompressed in groups and their messages gathered through the message index, each
one checked; where there is no index, or a wrong one, the records of the chunk are scanned.

What a killed recorder leaves behind is read as far as it goes: a missing end, or a chunk that is
cut short or fails its checksum, costs what it held and a warning, never the rest of the file.
Behind a record that makes no sense the next chunk is looked for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from io import BytesIO
import mmap
from pathlib import Path
import struct
import zlib

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema, Statistics
import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.arrays import Ints
from starcal_ros.files.foreign import clean
from starcal_ros.messages.cdr import Messages, RecordError
from starcal_ros.recording import losses
from starcal_ros.recording.mcap_chunk import NO_ENTRIES, RECORD, Chunk, locate, scan
from starcal_ros.recording.mcap_chunks import Chunks

MAGIC = b'\x89MCAP0\r\n'
RECOVERED = 'starcal_recovered'
"""Metadata of a file that was recovered, with what was lost."""

GROUP_BYTES = 4 << 20
"""What is decompressed at once."""
_FORGET_BYTES = 32 << 20    # of the file, that are gone through before their memory is given back
_COMPRESSIONS = (b'\4\0\0\0zstd', b'\3\0\0\0lz4')
_BEFORE_COMPRESSION = RECORD.size + 28      # bytes of a chunk
GARBLED = (struct.error, ValueError, OverflowError, McapError)
"""What parsing a damaged record may raise."""


class McapFile:
    """The channels, chunks and attachments of one MCAP file.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    RecordError
        If the file cannot be opened or is not MCAP.

    Attributes
    ----------
    channels, schemas : dict
        By their ids.
    attached : list of Attachment
        As they stand in the file.
    metadata : dict of dict
        Texts by their names, by the name of the record; the last one of a name.
    header : Header or None
        Its profile and what wrote it.
    chunks : Chunks
        In the order of the file, with their indices.
    finished : bool
        Whether the file has its summary and its end.
    lost_bytes : int
        How many bytes of its data make no sense.
    data : (n_bytes,) uint8 array
        The file, mapped into memory.
    position : int
        How far `messages` has come [bytes].
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._mapped = map_file(path)
        self.data = self._mapped.data
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.attached: list[Attachment] = []
        self.metadata: dict[str, dict[str, str]] = {}
        self.header: Header | None = None
        self.position = self.lost_bytes = 0
        self.finished = False
        self.chunks = Chunks(self.data.data)
        self._statistics: Statistics | None = None
        self._warnings: dict[str, None] = {}
        self._next_words = dict.fromkeys(_COMPRESSIONS, 0)
        self._walk()
        self._index_all_chunks()
        self._compare_with_statistics()
        for text in losses.texts(self.metadata.get(losses.LOSSES, {})):
            self._warn(text)
        if lost := self.metadata.get(RECOVERED, {}).get('lost'):
            self._warn(f'when it was recovered, {lost} were left out')

    @property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name."""
        return {attachment.name: attachment.data for attachment in self.attached}

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the file, so far as it has been read."""
        return tuple(self._warnings)

    @property
    def counts(self) -> Counter[int]:
        """Number of messages by channel."""
        return self.chunks.counts

    def log_times(self, channel: int) -> Ints:
        """Return the log times of a channel in the order of the file, (n,) ns."""
        return np.concatenate([np.empty(0, np.int64), *(
            chunk.index[channel][:, 0].astype(np.int64) for chunk in self._forgetting()
            if channel in chunk.index)])

    def span(self, channel: int) -> tuple[int, int] | None:
        """Return the least and the greatest log time of a channel [ns], None without messages."""
        chunk, first_ns, last_ns = self.chunks.holding([channel])
        low, high = 2**64, -1
        # Only chunks that reach beyond what is known by now are asked.
        for k in chunk[np.argsort(first_ns, kind='stable')].tolist():
            if self.chunks.chunk(k, []).first_ns > low:
                break
            low = min(low, self._limits(k, channel)[0])
        for k in chunk[np.argsort(-last_ns, kind='stable')].tolist():
            if self.chunks.chunk(k, []).last_ns < high:
                break
            high = max(high, self._limits(k, channel)[1])
        return (low, high) if high >= 0 else None

    def _limits(self, k: int, channel: int) -> tuple[int, int]:
        times = self.chunks.chunk(k, [channel]).index.get(channel, NO_ENTRIES)[:, 0]
        return (int(times.min()), int(times.max())) if len(times) else (2**64, -1)

    def _forgetting(self) -> Iterator[Chunk]:
        """Yield the chunks, and give back the memory of those that were gone through."""
        begin = 0
        for chunk in self.chunks:
            yield chunk
            if chunk.offset - begin > _FORGET_BYTES:
                begin = chunk.offset
                self.forget()
        self.forget()

    def forget(self) -> None:
        """Give back the memory of what was read; the file has it still."""
        self._mapped.forget()

    def messages(self, channels: Collection[int],
                 ) -> Iterator[tuple[int, Ints, Messages]]:
        """Read the messages of some channels, a few megabytes at a time.

        Yields
        ------
        channel : int
            One of the channel ids asked for.
        log_time : (n,) int64 array
            When the messages were recorded [ns].
        messages : Messages
            The messages, in the order of the file.
        """
        group: list[int] = []
        n_bytes = 0
        for k, chunk in enumerate(self.chunks):
            if not chunk.index.keys().isdisjoint(channels):
                group.append(k)
                n_bytes += chunk.size
            if n_bytes >= GROUP_BYTES:
                self.position = chunk.offset
                yield from self.read_chunks(group, channels)
                group, n_bytes = [], 0
        yield from self.read_chunks(group, channels)
        self.position = len(self.data)

    def read_chunks(self, numbers: Sequence[int], channels: Collection[int],
                    ) -> Iterator[tuple[int, Ints, Messages]]:
        """Read the messages of some channels in a few chunks, as `messages` does."""
        parts = {k: self.chunks.chunk(k, channels) for k in numbers}
        data = np.empty(sum(part.room for part in parts.values()) if len(parts) > 1 else 0,
                        np.uint8)
        chunks, edges = {}, [0]
        for k, part in parts.items():
            raw = self._decompress(part)
            if raw is None:
                continue
            chunks[k] = part
            edges.append(edges[-1] + len(raw))
            if len(parts) > 1:          # its memory is that of the next one
                data[edges[-2]:edges[-1]] = np.frombuffer(raw, np.uint8)
            else:
                data = np.frombuffer(raw, np.uint8)
        data = data[:edges[-1]]
        self.forget()
        for channel in channels:
            found = locate(channel, [chunk.index for chunk in chunks.values()], data,
                           np.array(edges))
            if found is None:
                self._warn('the message index is wrong in or after the chunk at byte '
                           f'{next(iter(chunks.values())).offset}: the records are scanned '
                           'instead')
                for (k, chunk), low, high in zip(chunks.items(), edges, edges[1:]):
                    chunk.index, _ = scan(data.data[low:high])
                    self.chunks.set_index(k, chunk.index)
                found = locate(channel, [chunk.index for chunk in chunks.values()], data,
                               np.array(edges))
            if found is not None and len(found[1]):
                yield channel, *found

    def _walk(self) -> None:
        """Go from record to record over the file."""
        view = self.data.data
        position, opcode, loose, begin = len(MAGIC), 0, False, 0
        while opcode != Opcode.FOOTER:
            end = position
            if position + RECORD.size <= len(view):
                opcode, length = RECORD.unpack_from(view, position)
                end = position + RECORD.size + length
            if not position < end <= len(view) or opcode == 0:
                self.chunks.drop_index()
                position, opcode = self._resume(position), 0
                if position == len(view):
                    break
                continue
            try:
                self._take(opcode, position, view[position + RECORD.size:end])
            except GARBLED:
                self._warn(f'the record at byte {position} is garbled and left out')
            loose |= opcode == Opcode.MESSAGE
            position = end
            if position - begin > _FORGET_BYTES:
                begin = position
                self.forget()
        self.chunks.finish(view[len(MAGIC):] if loose else None)
        self.forget()

    def _resume(self, position: int) -> int:
        """Return where the next chunk begins behind a record that makes no sense, or the end."""
        n_bytes, behind = len(self.data), position + 1 + _BEFORE_COMPRESSION
        for word, at in self._next_words.items():
            if at < behind:             # else known from the last time
                self._next_words[word] = _find(self.data.data, word, behind)
        at = min(n_bytes, *(at - _BEFORE_COMPRESSION for at in self._next_words.values()))
        if self._statistics is None:            # what follows these is no data
            self.lost_bytes += at - position
        self._warn(f'the file breaks off at byte {position} of {n_bytes}, as after a killed '
                   'recorder; it is read as far as it goes' if at == n_bytes else
                   f'bytes {position} to {at} make no sense and are left out')
        return at

    def _take(self, opcode: int, position: int, content: memoryview) -> None:
        """Keep what one record of the file says."""
        if opcode == Opcode.CHUNK:
            self.chunks.add(position, content)
        elif opcode == Opcode.MESSAGE_INDEX:
            self.chunks.add_index(position, content)
        elif opcode == Opcode.ATTACHMENT:
            (crc,) = struct.unpack('<I', content[-4:])
            if crc and zlib.crc32(content[:-4]) != crc:
                raise ValueError('attachment checksum')
            self.attached.append(Attachment.read(stream(content)))
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(stream(content))
            self.metadata[metadata.name] = metadata.metadata
        elif opcode == Opcode.HEADER:
            self.header = Header.read(stream(content))
        elif opcode == Opcode.FOOTER:
            self.finished = self._statistics is not None
        elif opcode == Opcode.STATISTICS:
            self._statistics = Statistics.read(stream(content))
        else:
            self._declare(opcode, content)

    def _declare(self, opcode: int, content: bytes | memoryview) -> None:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream(content))
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream(content))
            self.channels[channel.id] = channel

    def _index_all_chunks(self) -> None:
        """Scan the chunks without an index, and those that alone declare their channels."""
        for k in range(len(self.chunks)):
            held = self.chunks.channels(k)
            if held and held <= self.channels.keys():
                continue
            chunk = self.chunks[k]
            raw = self._decompress(chunk)
            self.forget()
            if raw is not None:
                index, others = scan(raw)
                self.chunks.set_index(k, index)
                try:
                    for opcode, content in others:
                        self._declare(opcode, content)
                except GARBLED:
                    self._warn(f'a record in the chunk at byte {chunk.offset} is garbled')

    def _compare_with_statistics(self) -> None:
        for channel, count in (self._statistics.channel_message_counts.items()
                               if self._statistics else ()):
            held = self.counts[channel]
            if held != count and channel in self.channels:
                self._warn(f"by the file's statistics {self.channels[channel].topic} has {count} "
                           f'messages, by its chunks {held}')

    def _decompress(self, chunk: Chunk) -> bytes | memoryview | None:
        try:
            return chunk.decompress()
        except RecordError as error:
            self._warn(f'the chunk at byte {chunk.offset} is left out: {error}')
            return None

    def _warn(self, text: str) -> None:
        self._warnings[clean(f'{self.path.name}: {text}')] = None


class MappedFile:
    """A file mapped into memory.

    Attributes
    ----------
    data : (n_bytes,) uint8 array
        The file.
    """

    def __init__(self, file: mmap.mmap) -> None:
        self._map = file
        self.data: NDArray[np.uint8] = np.frombuffer(file, np.uint8)

    def forget(self) -> None:
        """Give the memory back of what was looked at; the file has it still."""
        if hasattr(mmap, 'MADV_DONTNEED'):
            self._map.madvise(mmap.MADV_DONTNEED)


def map_file(path: Path) -> MappedFile:
    """Map an MCAP file into memory; RecordError where it can not be opened or is none."""
    try:
        if path.stat().st_size < len(MAGIC):
            raise RecordError(f'{path} is not an MCAP file: it has {path.stat().st_size} bytes')
        with path.open('rb') as file:
            mapped = MappedFile(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    except OSError as error:
        raise RecordError(f'{path} cannot be read: {error.strerror}') from error
    start = mapped.data[:len(MAGIC)].tobytes()
    if start != MAGIC:
        raise RecordError(f'{path} is not an MCAP file: it starts with {start!r}, not {MAGIC!r}')
    return mapped


def _find(whole: memoryview, word: bytes, start: int) -> int:
    """Return where a word stands in a file, read a few megabytes at a time, or behind its end."""
    for low in range(start, len(whole), GROUP_BYTES):
        at = whole[low:low + GROUP_BYTES + len(word) - 1].tobytes().find(word)
        if at >= 0:
            return low + at
    return len(whole) + _BEFORE_COMPRESSION


def stream(content: bytes | memoryview) -> ReadDataStream:
    """Return a record for the `read` of its kind."""
    return ReadDataStream(BytesIO(content))
