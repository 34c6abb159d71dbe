# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings that are small as files and large in memory."""

import struct
import tracemalloc
import zlib

import lz4.frame
from mcap.opcode import Opcode
import mcap.writer
import numpy as np
import pytest
import zstandard

from starcal_ros.files.limits import CHUNK
from starcal_ros.messages.cdr import RecordError
from starcal_ros.recording.mcap_check import check_file
from starcal_ros.recording.mcap_chunk import MESSAGE_HEAD, RECORD, locate, scan
from starcal_ros.recording.mcap_reader import MAGIC
from starcal_ros.recording.reader import read, summary

EMPTY = 'std_msgs/msg/Empty'
LARGE = 60_000_000
PEAK = 12_000_000


def zstd(n_bytes, stated=True):
    """Compress zeros."""
    return zstandard.ZstdCompressor(write_content_size=stated).compress(bytes(n_bytes))


def lz4_(n_bytes, stated=True):
    """Compress zeros."""
    return lz4.frame.compress(bytes(n_bytes), store_size=stated)


def recording(path, compression, packed, size):
    """Write an MCAP file of one chunk, which announces a size."""
    name = compression.encode()
    content = (struct.pack('<QQQII', 0, 0, size, 0, len(name)) + name
               + struct.pack('<Q', len(packed)) + packed)
    path.write_bytes(MAGIC + struct.pack('<BQ', Opcode.CHUNK, len(content)) + content)
    return path


@pytest.fixture
def small_memory(monkeypatch):
    """Allow a few megabytes, and see that no more are taken."""
    monkeypatch.setenv(CHUNK.variable, '2')
    tracemalloc.start()
    yield
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < PEAK


BOMBS = {f'{name} {stated} {size}': (name, stated, size) for name in ('zstd', 'lz4')
         for stated in (True, False) for size in (LARGE, 1000, 2**40, 2**64 - 1)}


@pytest.fixture(scope='module')
def packed():
    """Return what the bombs are made of, made outside of the measured memory."""
    return {(name, stated): make(LARGE, stated) for name, make in (('zstd', zstd), ('lz4', lz4_))
            for stated in (True, False)}


@pytest.mark.parametrize('bomb', BOMBS)
def test_a_bomb_is_left_out_before_it_goes_off(tmp_path, packed, small_memory, bomb):
    name, stated, size = BOMBS[bomb]
    path = recording(tmp_path / 'bomb.mcap', name, packed[name, stated], size)
    warning = ' '.join(summary(path).warnings)
    assert 'the chunk at byte 8 is left out' in warning
    if size > 2e6:
        assert 'MB, at most 2 are read (STARCAL_MAX_CHUNK_MB)' in warning


def test_the_reason_stands_in_the_error_too(tmp_path, packed):
    path = recording(tmp_path / 'bomb.mcap', 'zstd', packed['zstd', True], 2**33)
    with pytest.raises(RecordError, match='has no topic .*at most 256 are read'):
        read(path)


@pytest.mark.parametrize('name', ['zstd', 'lz4'])
@pytest.mark.parametrize('stated', [True, False])
def test_large_chunks_are_read_where_they_are_allowed(tmp_path, packed, monkeypatch, name, stated):
    monkeypatch.setenv(CHUNK.variable, '60')
    path = recording(tmp_path / 'large.mcap', name, packed[name, stated], LARGE)
    assert not [text for text in summary(path).warnings if 'left out' in text]


@pytest.mark.parametrize('record', [
    bytes(9), struct.pack('<BQ', 0x50, 0), struct.pack('<BQ', Opcode.SCHEMA, 0),
    struct.pack('<BQHB', Opcode.CHANNEL, 3, 7, 0),
    struct.pack('<BQHIQQ', Opcode.MESSAGE, 22, 7, 1, 2, 3)], ids=len)
def test_many_small_records_take_no_more_memory_than_the_chunk(record):
    raw = record * (4_000_000 // len(record))
    tracemalloc.start()
    index, others = scan(raw)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * len(raw) and len(others) <= 1
    assert sum(map(len, index.values())) in (0, len(raw) // 31)


def test_one_message_named_many_times_is_not_read_many_times():
    """Each entry of an index has 16 bytes; what it names may have megabytes."""
    raw = struct.pack('<BQHIQQ', Opcode.MESSAGE, 22 + 1000, 7, 1, 2, 3) + bytes(1000)
    once, often = ({7: np.array([[2, 0]] * n, np.uint64)} for n in (1, 1000))
    data, edges = np.frombuffer(raw, np.uint8), np.array([0, len(raw)])
    time_ns, messages = locate(7, [once], data, edges)
    assert time_ns.tolist() == [2] and messages.size.tolist() == [1000]
    assert MESSAGE_HEAD.itemsize + 1000 == len(raw)
    assert locate(7, [often], data, edges) is None


def test_a_checksum_does_not_help_a_bomb(tmp_path, monkeypatch):
    monkeypatch.setenv(CHUNK.variable, '2')
    raw = bytes(3_000_000)
    content = (struct.pack('<QQQII', 0, 0, len(raw), zlib.crc32(raw), 4) + b'zstd'
               + struct.pack('<Q', 9) + bytes(9))
    path = tmp_path / 'bomb.mcap'
    path.write_bytes(MAGIC + struct.pack('<BQ', Opcode.CHUNK, len(content)) + content)
    assert 'zstd data of 3 MB, at most 2 are read' in ' '.join(summary(path).warnings)


def test_a_length_beyond_all_memory_is_garbled_in_whatever_record_it_stands(tmp_path):
    path = tmp_path / 'run.mcap'
    with path.open('wb') as stream:
        writer = mcap.writer.Writer(stream)
        writer.start('ros2', 'test')
        channel = writer.register_channel('a', 'cdr', writer.register_schema(EMPTY, '', b''))
        writer.add_message(channel, 1, bytes(5), 1)
        writer.add_attachment(0, 0, 'a.txt', 'text/plain', b'text')
        writer.add_metadata('about', {'this': 'file'})
        writer.finish()
    data, at, places = path.read_bytes(), len(MAGIC), []
    while at < len(data) - len(MAGIC):
        opcode, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        places += range(at, at + length - 7)
        if opcode == Opcode.ATTACHMENT:         # without a checksum, which would tell
            data = data[:at + length - 4] + bytes(4) + data[at + length:]
        at += length
    for place in places:
        path.write_bytes(data[:place] + b'\xff' * 8 + data[place + 8:])
        for reads in (check_file, summary, read):
            try:
                reads(path)
            except RecordError as error:
                assert str(error)
