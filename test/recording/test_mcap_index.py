# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The chunk index of a long file takes little memory until it is written, and loses nothing."""

import tracemalloc

from mcap.reader import make_reader
import numpy as np

from starcal_ros.recording.mcap_check import check_file
from starcal_ros.recording.mcap_index import ChunkIndices
from starcal_ros.recording.writer import Writer

STRING = 'std_msgs/msg/String'
SECONDS = 4000


def test_records_come_out_as_they_went_in():
    records = [bytes([k % 251]) * (100 + k % 7) for k in range(4000)]
    indices = ChunkIndices()
    assert indices.span_ns is None and b''.join(indices) == b''
    for k, record in enumerate(records):
        indices.add(record, 10 * k + 5, 10 * k + 9)
    assert b''.join(indices) == b''.join(indices) == b''.join(records)
    assert (indices.count, indices.n_bytes) == (4000, sum(map(len, records)))
    assert indices.span_ns == (5, 39_999)


def test_a_file_grows_in_memory_by_less_than_60_bytes_a_chunk(tmp_path):
    path, topics = tmp_path / 'long.mcap', [f'/topic_{k}' for k in range(8)]
    with Writer(path) as writer:
        for second in range(SECONDS):
            for topic in topics:
                writer.write(topic, STRING, b'\0\1\0\0\2\0\0\0a\0', second * 10**9)
            if second == 200:
                tracemalloc.start()
            if second == SECONDS // 2:
                half = tracemalloc.get_traced_memory()[0]
        grown = tracemalloc.get_traced_memory()[0] - half
        tracemalloc.stop()
        # Less than 64 KiB wait for their compression, in a buffer that may be twice that.
        assert grown < 60 * SECONDS // 2
    found = check_file(path)
    assert not found.faults and found.chunks == SECONDS
    with path.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert len(summary.chunk_indexes) == SECONDS
    assert summary.statistics.message_count == 8 * SECONDS
    starts = np.array([index.message_start_time for index in summary.chunk_indexes])
    np.testing.assert_array_equal(starts, np.arange(SECONDS) * 10**9)
