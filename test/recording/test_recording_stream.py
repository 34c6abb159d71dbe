# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A recording is read in the order of its recording, in parts, and in a memory that is bounded."""

from dataclasses import astuple
import tracemalloc

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer as RosbagsWriter

from instruments import TAN2018
from starcal_ros.measurements.message_source import InMemory, about, beginning, extent
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.messages.cdr_imu import IMU_TYPE, encode_imu
from starcal_ros.messages.cdr_pointcloud import CLOUD_TYPE, encode_centroids
from starcal_ros.recording import mcap_chunks, reader
from starcal_ros.recording.bag import Span
from starcal_ros.recording.bag_writer import BagWriter
from starcal_ros.recording.mcap_reader import McapFile
from starcal_ros.recording.recording_stream import RecordingStream
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch, typestore
from starcal_ros.simulation import sensors
from starcal_ros.simulation.write_recording import simulate

SHORT = TAN2018.replace({'simulation.duration_s': 40.0})
START = sensors.gyro(SHORT).stamp_ns(0) // 10**9 * 10**9
IMU, STARS = '/imu/data_raw', '/star_tracker/centroids'


@pytest.fixture(scope='module')
def messages():
    gyro, tracker = sensors.gyro(SHORT), sensors.star_tracker(SHORT)
    return gyro.next(gyro.count), tracker.next(tracker.count)


@pytest.fixture(autouse=True)
def small_groups(monkeypatch):
    """Read a few seconds at once, so that a recording has many batches."""
    monkeypatch.setattr('starcal_ros.recording.bag.GROUP_BYTES', 200_000)
    monkeypatch.setattr('starcal_ros.simulation.write_recording._CHUNK_S', 1)


def in_order(path, gyro, frames):
    simulate(SHORT, path)


def topic_by_topic(path, gyro, frames):
    with Writer(path) as writer:
        writer.write_imu(IMU, gyro)
        writer.write_centroids(STARS, frames)


def in_disorder(path, gyro, frames):
    seconds = np.random.default_rng(3).permutation(40)
    with Writer(path) as writer:
        for second in seconds.tolist():
            low, high = (START + (second + k) * 10**9 for k in (0, 1))
            writer.write_batches(*(make(topic, part.take((part.stamp_ns >= low) & (
                part.stamp_ns < high))) for make, topic, part in (
                    (imu_batch, IMU, gyro), (centroids_batch, STARS, frames))))
        writer.write_imu(IMU, gyro.take(gyro.stamp_ns >= START + 40 * 10**9))


def split(path, gyro, frames):
    writer = BagWriter(path.with_suffix(''), max_ns=7 * 10**9)
    for low in range(0, 40, 2):
        writer.write([make(topic, part.take((part.stamp_ns >= START + low * 10**9) & (
            part.stamp_ns < START + (low + 2) * 10**9))) for make, topic, part in (
                (imu_batch, IMU, gyro), (centroids_batch, STARS, frames))])
    writer.write([imu_batch(IMU, gyro.take(gyro.stamp_ns >= START + 40 * 10**9))])
    writer.close()
    return writer.path


def sqlite(path, gyro, frames):
    folder = path.with_suffix('')
    with RosbagsWriter(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        for topic, kind, stamps, encoded in (
                (IMU, IMU_TYPE, gyro.stamp_ns, encode_imu(gyro)),
                (STARS, CLOUD_TYPE, frames.stamp_ns, encode_centroids(frames))):
            connection = writer.add_connection(topic, kind, typestore=typestore())
            for stamp_ns, message in zip(stamps.tolist(), encoded):
                writer.write(connection, stamp_ns, bytes(message))
    return folder


@pytest.mark.parametrize('write', [in_order, topic_by_topic, in_disorder, split, sqlite])
def test_batches_go_on_from_each_other_in_time_whatever_the_order_of_the_file(
        tmp_path, monkeypatch, messages, write):
    monkeypatch.setattr('starcal_ros.recording.bag._BATCH', 300)
    path = write(tmp_path / 'run.mcap', *messages) or tmp_path / 'run.mcap'
    stream = RecordingStream(path)
    for _ in range(2):                          # again and again
        batches = list(stream.batches())
        assert len(batches) > 3 and batches[-1].done == 1.0
        assert all(a.done <= b.done for a, b in zip(batches, batches[1:]))
        gyro = GyroSamples.concatenate([batch.gyro for batch in batches])
        frames = Frames.concatenate([batch.frames for batch in batches])
        for found, given in zip((*astuple(gyro), *astuple(frames)),
                                (*astuple(messages[0]), *astuple(messages[1]))):
            np.testing.assert_allclose(found, given, rtol=1e-7)     # sigma is a float32
        # What belongs together comes together: no topic runs away from the other.
        ends = [(int(batch.gyro.stamp_ns[-1]), int(batch.frames.stamp_ns[-1]))
                for batch in batches if len(batch.gyro) and len(batch.frames)]
        assert len(ends) > 3 and max(abs(a - b) for a, b in ends) <= 2 * 10**9
    assert stream.warnings == () and stream.gyro_topic == IMU
    assert stream.frame_ids == {IMU: 'gyro', STARS: 'star_tracker_optical'}
    assert stream.span(IMU) == (messages[0].stamp_ns[0], messages[0].stamp_ns[-1])
    assert stream.span(STARS) == (messages[1].stamp_ns[0], messages[1].stamp_ns[-1])


def test_times_that_are_asked_for_are_read_alone(tmp_path, messages):
    simulate(SHORT, tmp_path / 'run.mcap')
    stream = RecordingStream(tmp_path / 'run.mcap')
    within = [Span(START + 3 * 10**9, START + 5 * 10**9), Span(START + 30 * 10**9, 2**62)]
    batches = list(stream.batches(within))
    for found, given in ((np.concatenate([batch.gyro.stamp_ns for batch in batches]),
                          messages[0].stamp_ns),
                         (np.concatenate([batch.frames.stamp_ns for batch in batches]),
                          messages[1].stamp_ns)):
        since_s = (given - START) * 1e-9
        np.testing.assert_array_equal(
            found, given[(since_s >= 3.0) & (since_s <= 5.0) | (since_s >= 30.0)])
    assert stream.warnings == ()                # a part is not all there is


def test_a_chunk_whose_head_and_index_disagree_is_scanned(tmp_path, messages):
    path = tmp_path / 'run.mcap'
    topic_by_topic(path, *messages)
    offset = McapFile(path).chunks[7].offset
    with path.open('r+b') as file:              # the head of the chunk says 1970
        file.seek(offset + 9)
        file.write(bytes(16))
    chunks = McapFile(path).chunks
    assert chunks.counts == {1: 4000, 2: 80}
    numbers, first, last = chunks.holding([1])
    assert len(numbers) == 41 and first.min() == messages[0].stamp_ns[0]
    np.testing.assert_array_equal(reader.read(path).gyro.stamp_ns, messages[0].stamp_ns)


def test_places_of_chunks_take_little_memory(tmp_path):
    gyro = sensors.gyro(TAN2018.replace({'simulation.duration_s': 1000.0}))
    with Writer(tmp_path / 'run.mcap') as writer:
        writer.write_imu(IMU, gyro.next(gyro.count).take(np.arange(0, 100_000, 50)))
    file = McapFile(tmp_path / 'run.mcap')
    content = {k: file.chunks._content(file.chunks._offsets[k]) for k in range(1000)}
    tracemalloc.start()
    kept = mcap_chunks.Chunks(file.data.data)
    for k, part in content.items():
        kept.add(file.chunks._offsets[k], part)
    kept.finish(None)
    assert tracemalloc.get_traced_memory()[0] < 60 * 1000
    tracemalloc.stop()


def test_parts_of_a_run_by_the_stamps_of_its_frames(tmp_path, messages):
    simulate(SHORT, tmp_path / 'run.mcap')
    for source in (InMemory(*messages), RecordingStream(tmp_path / 'run.mcap')):
        run = extent(source)
        assert run == (80, messages[1].stamp_ns[0], messages[1].stamp_ns[-1])
        first = beginning(source, 10.0)
        assert (len(first.frames), len(first.gyro)) == (20, 1000)
        part = about(source, run, 10.0, int(messages[1].stamp_ns[40]))
        assert len(part.frames) == 21 and 1010 <= len(part.gyro) <= 1012
        assert part.frames.stamp_ns[10] == messages[1].stamp_ns[40]


def test_a_pass_takes_no_more_memory_of_a_long_recording(tmp_path, monkeypatch):
    peaks = []
    for seconds in (60.0, 240.0):
        path = tmp_path / f'{seconds}.mcap'
        simulate(SHORT.replace({'simulation.duration_s': seconds}), path)
        tracemalloc.start()
        counts = [(len(batch.gyro), len(batch.frames))
                  for batch in RecordingStream(path).batches()]
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert np.sum(counts, axis=0).tolist() == [100 * seconds, 2 * seconds]
    # 180 s more are 576 kB of readings and 370 kB of stars; their chunks' places are 6 kB.
    assert peaks[1] < peaks[0] + 50_000
