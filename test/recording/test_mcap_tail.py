# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How far a recording has come is seen while it is written."""

import numpy as np

from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.recording.mcap_tail import McapTail
from starcal_ros.recording.writer import Writer

START_NS = 1_782_993_600_000_000_000


def samples(low_s, high_s):
    stamp_ns = START_NS + np.arange(low_s * 100, high_s * 100) * 10**7
    return GyroSamples(stamp_ns, np.zeros((len(stamp_ns), 3)))


def test_tail_grows_with_the_chunks_of_the_file(tmp_path):
    path = tmp_path / 'run.mcap'
    tail = McapTail(path)
    assert tail.newest_ns() == 0                # no file yet
    with Writer(path) as writer:
        assert tail.newest_ns() == 0
        for low, high in ((0, 5), (5, 9)):
            writer.write_imu('/imu/data_raw', samples(low, high))
            writer.flush()
            assert tail.newest_ns() == START_NS + high * 10**9 - 10**7
        writer.write_imu('/imu/data_raw', samples(9, 10))
    assert tail.newest_ns() == START_NS + 10**10 - 10**7
    assert McapTail(path).newest_ns() == tail.newest_ns()


def test_tail_waits_for_the_rest_of_a_chunk(tmp_path):
    whole, path = tmp_path / 'whole.mcap', tmp_path / 'run.mcap'
    with Writer(whole) as writer:
        writer.write_imu('/imu/data_raw', samples(0, 4))
    content, tail, seen = whole.read_bytes(), McapTail(path), []
    for size in range(0, len(content) + 1, 100):
        path.write_bytes(content[:size])
        seen.append(tail.newest_ns())
    path.write_bytes(content)
    assert sorted(seen) == seen and set(seen) == {
        0, *(START_NS + second * 10**9 - 10**7 for second in (1, 2, 3, 4))}
    assert tail.newest_ns() == seen[-1]
