# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether an MCAP file is what it says: every checksum, count and declaration in it.

`McapFile` reads what can be read of any file; this finds what is wrong with one. The checksum of
the data section covers each byte before the summary, that of the summary the rest. Where a writer
left checksums out, as the format allows, what they would cover is told.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
import struct
import zlib

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics
import numpy as np
from rosbags.typesys import get_types_from_msg

from starcal_ros.files.foreign import clean
from starcal_ros.messages.cdr import RecordError
from starcal_ros.recording.mcap_chunk import RECORD, Chunk, Index, scan
from starcal_ros.recording.mcap_reader import GARBLED, MAGIC, map_file, stream

_TIMES = struct.Struct('<QQ')       # of the first and the last message, at the head of a chunk
_FOOTER = struct.Struct('<QQI')


@dataclass
class Findings:
    """What a check has found.

    Attributes
    ----------
    faults : list of str
        What is wrong, in the order of the file.
    unchecked : list of str
        What has no checksum.
    chunks, messages : int
        How many are sound.
    """

    faults: list[str] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)
    chunks: int = 0
    messages: int = 0


def check_file(path: Path) -> Findings:
    """Check an MCAP file.

    Raises
    ------
    RecordError
        If the file cannot be opened or is not MCAP.
    """
    return _Check(path).run()


class _Check:
    """One walk over a file."""

    def __init__(self, path: Path) -> None:
        self._mapped = map_file(path)
        self._view = self._mapped.data.data
        self._found = Findings()
        self._declared: dict[tuple[int, int], bytes] = {}       # by opcode and id
        self._counts: Counter[int] = Counter()
        self._chunks: dict[int, tuple[int, Chunk]] = {}         # by offset: length of its record
        self._indices: dict[int, Index] = {}                    # as the file has them
        self._latest = 0
        self._summary: int | None = None        # where it begins

    def run(self) -> Findings:
        """Return what is found."""
        view, position, opcode = self._view, len(MAGIC), 0
        while opcode != Opcode.FOOTER:
            end = position
            if position + RECORD.size <= len(view):
                opcode, length = RECORD.unpack_from(view, position)
                end = position + RECORD.size + length
            if not position < end <= len(view) or opcode == 0:
                self._fault(f'the file breaks off at byte {position} of {len(view)}, without its '
                            'summary')
                break
            try:
                self._take(opcode, position, view[position + RECORD.size:end])
            except GARBLED as error:
                self._fault(f'the record at byte {position} is garbled: {error}')
            position = end
        else:
            if bytes(view[position:]) != MAGIC:
                self._fault(f'the file ends with {bytes(view[position:position + 16])!r}, not '
                            f'{MAGIC!r}')
        self._compare_indices()
        return self._found

    def _take(self, opcode: int, position: int, content: memoryview) -> None:
        if opcode == Opcode.DATA_END:
            self._compare('the data section', struct.unpack('<I', content)[0], 0, position)
            self._summary = position + RECORD.size + len(content)
            self._has = Counter(opcode for opcode, _ in self._declared)
        elif opcode == Opcode.FOOTER:
            start, _, crc = _FOOTER.unpack(content)
            if self._summary is None:
                self._fault('the data section has no end')
                return
            if start not in (0, self._summary):
                self._fault(f'its end names a summary at byte {start}; it is at {self._summary}')
            self._compare('the summary', crc, self._summary,
                          position + RECORD.size + _FOOTER.size - 4)
        elif opcode == Opcode.CHUNK:
            self._take_chunk(position, content)
        elif opcode == Opcode.MESSAGE_INDEX:
            channel, length = struct.unpack_from('<HI', content)
            self._indices.setdefault(self._latest, {})[channel] = np.frombuffer(
                content[6:6 + length], '<u8').reshape(-1, 2)
        elif opcode == Opcode.MESSAGE:
            self._count(int(struct.unpack_from('<H', content)[0]), 1)
        elif opcode == Opcode.ATTACHMENT:
            if crc := struct.unpack('<I', content[-4:])[0]:
                if zlib.crc32(content[:-4]) != crc:
                    self._fault(f'the checksum of the attachment at byte {position} is wrong')
        elif opcode == Opcode.CHUNK_INDEX:
            self._take_chunk_index(ChunkIndex.read(stream(content)))
        elif opcode == Opcode.STATISTICS:
            self._take_statistics(Statistics.read(stream(content)))
        else:
            self._declare(opcode, content)

    def _take_chunk(self, position: int, content: memoryview) -> None:
        self._latest, chunk = position, Chunk.parse(position, content)
        self._chunks[position] = len(content) + RECORD.size, chunk
        try:
            raw = chunk.decompress()
        except RecordError as error:
            self._fault(f'the chunk at byte {position}: {error}')
            return
        if not chunk.crc:
            self._unchecked('chunks')
        chunk.index, others = scan(raw)
        for opcode, record in others:
            self._declare(opcode, record)
        low, high = _TIMES.unpack_from(content)
        for channel, entries in chunk.index.items():
            self._count(channel, len(entries))
            if entries[:, 0].min() < low or entries[:, 0].max() > high:
                self._fault(f'the chunk at byte {position} holds log times outside of those that '
                            'it names')
        self._found.chunks += 1

    def _take_chunk_index(self, index: ChunkIndex) -> None:
        length, _ = self._chunks.get(index.chunk_start_offset, (None, None))
        if length != index.chunk_length:
            self._fault(f'the summary names a chunk at byte {index.chunk_start_offset} that is '
                        'not there')

    def _take_statistics(self, statistics: Statistics) -> None:
        stated = {channel: count for channel, count in statistics.channel_message_counts.items()
                  if count}
        if stated != dict(self._counts) or statistics.message_count != self._counts.total():
            self._fault(f'{self._counts.total()} messages are found, the statistics say '
                        f'{statistics.message_count}')
        if statistics.chunk_count != len(self._chunks):
            self._fault(f'{len(self._chunks)} chunks are found, the statistics say '
                        f'{statistics.chunk_count}')

    def _declare(self, opcode: int, content: bytes | memoryview) -> None:
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
            return
        record = (Schema if opcode == Opcode.SCHEMA else Channel).read(stream(content))
        # Written anew: the entries of a map may come in any order.
        builder = RecordBuilder()
        record.write(builder)
        data: bytes = builder.end()     # type: ignore[no-untyped-call]
        known = self._declared.get((opcode, record.id))
        if known is None and self._summary is not None and self._has:
            self._fault(f'the summary declares {_name(record)}, which the data do not have')
        if known not in (None, data):
            self._fault(f'{_name(record)} is declared in two ways')
        if known is None and isinstance(record, Schema):
            self._parse(record)
        self._declared[opcode, record.id] = data

    def _parse(self, schema: Schema) -> None:
        if schema.encoding == 'ros2msg' and schema.data:
            try:
                get_types_from_msg(schema.data.decode(), schema.name)
            except Exception as error:          # a parser's own, of any kind
                text = ' '.join(str(error).split())[:100]
                self._fault(f'the definition of {schema.name} cannot be parsed: {text}')

    def _count(self, channel: int, number: int) -> None:
        self._counts[channel] += number
        self._found.messages += number
        if (Opcode.CHANNEL, channel) not in self._declared:
            self._fault(f'messages of channel {channel}, which is not declared')

    def _compare_indices(self) -> None:
        for position, (_, chunk) in self._chunks.items():
            if position not in self._indices:
                continue
            stated, held = self._indices[position], chunk.index
            if {*stated} != {*held} or not all(
                    np.array_equal(stated[channel], held[channel]) for channel in held):
                self._fault(f'the message index after the chunk at byte {position} does not fit '
                            'it')

    def _compare(self, what: str, stated: int, start: int, end: int) -> None:
        if not stated:
            self._unchecked(what)
        elif zlib.crc32(self._view[start:end]) != stated:
            self._fault(f'the checksum of {what} is wrong')

    def _fault(self, text: str) -> None:
        if clean(text) not in self._found.faults:
            self._found.faults.append(clean(text))

    def _unchecked(self, what: str) -> None:
        if what not in self._found.unchecked:
            self._found.unchecked.append(what)


def _name(record: Schema | Channel) -> str:
    return (f'the type {record.name}' if isinstance(record, Schema) else
            f'the topic {record.topic}')
