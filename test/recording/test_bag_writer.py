# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings while they are made: split, on a full disk, removed."""

from collections import Counter
from dataclasses import replace
import os
import shutil
from types import SimpleNamespace

from mcap.reader import make_reader
import numpy as np
import pytest
from rosbags import rosbag2
import yaml

from starcal_ros.messages.cdr import RecordError
from starcal_ros.recording.bag_writer import BagWriter
from starcal_ros.recording.losses import Loss
from starcal_ros.recording.mcap_check import check_file
from starcal_ros.recording.reader import FRAMES_TOPIC, GYRO_TOPIC, read
from starcal_ros.recording.writer import centroids_batch, imu_batch
from written import FRAMES, GYRO, assert_same

STEP = 10**9


def batches():
    """Yield what a recorder writes, a second at a time."""
    start = int(GYRO.stamp_ns[0])
    for low in range(start, start + 10 * STEP, STEP):
        rows = np.flatnonzero((GYRO.stamp_ns >= low) & (GYRO.stamp_ns < low + STEP))
        frames = np.flatnonzero((FRAMES.stamp_ns >= low) & (FRAMES.stamp_ns < low + STEP))
        yield [imu_batch(GYRO_TOPIC, type(GYRO)(GYRO.stamp_ns[rows], GYRO.rate[rows])),
               centroids_batch(FRAMES_TOPIC, FRAMES.take(frames))]


def record(path, **options):
    """Write a recording."""
    writer = BagWriter(path, **options)
    writer.attach('config.yaml', b'a: 1\n', 'application/yaml')
    for each in batches():
        writer.write(each)
    writer.close()
    return writer.path


def told(path):
    """Return the metadata of a directory."""
    return yaml.safe_load((path / 'metadata.yaml').read_text())['rosbag2_bagfile_information']


@pytest.mark.parametrize('name', ['run', 'run.mcap'])
@pytest.mark.parametrize('options, files', [
    ({'max_ns': 3 * STEP}, 4), ({'max_bytes': 12_000}, 5), ({'max_ns': STEP // 2}, 20)])
def test_a_recording_is_split_as_rosbag2_does(tmp_path, monkeypatch, name, options, files):
    monkeypatch.setenv('ROS_DISTRO', 'kilted')
    path = record(tmp_path / name, **options)
    assert path == tmp_path / 'run'
    names = [f'run_{k}.mcap' for k in range(files)]
    assert sorted(each.name for each in path.iterdir()) == sorted([*names, 'metadata.yaml'])
    metadata = told(path)
    assert metadata['relative_file_paths'] == names == [
        each['path'] for each in metadata['files']]
    assert metadata['ros_distro'] == 'kilted' and metadata['message_count'] == 1020
    recording = read(path)
    assert_same(recording.gyro, GYRO)
    assert_same(recording.frames, FRAMES)
    assert recording.warnings == () and recording.attachments == {'config.yaml': b'a: 1\n'}
    for each, expected in zip(names, metadata['files']):
        found = check_file(path / each)
        assert (found.faults, found.messages) == ([], expected['message_count'])
        if 'max_ns' in options:
            assert expected['duration']['nanoseconds'] < options['max_ns']
    with rosbag2.Reader(path) as bag:
        counts = Counter(connection.topic for connection, _, _ in bag.messages())
    assert counts == {GYRO_TOPIC: 1000, FRAMES_TOPIC: 20}


def test_a_directory_that_exists_is_kept(tmp_path):
    (tmp_path / 'run').mkdir()
    with pytest.raises(RecordError, match='run exists'):
        BagWriter(tmp_path / 'run', max_bytes=1)


def test_what_is_written_together_is_one_chunk_though_topics_are_minutes_apart(tmp_path):
    """A chunk a second of each topic would be many, and the index of them grow in memory."""
    path = tmp_path / 'run.mcap'
    writer = BagWriter(path)
    for gyro, frames in batches():
        writer.write([gyro, replace(frames, log_time_ns=frames.log_time_ns + 100 * STEP)])
    writer.close()
    found = check_file(path)
    assert not found.faults and found.chunks == len([*batches()])


def test_losses_stand_in_the_file_at_once_and_in_the_metadata(tmp_path):
    writer = BagWriter(tmp_path / 'run', max_ns=5 * STEP)
    for k, each in enumerate(batches()):
        writer.losses = {GYRO_TOPIC: Loss(7 if k > 2 else 0, 0.08, 2 if k > 6 else 0)}
        writer.write(each)
        if k == 3:
            warning, _ = read(tmp_path / 'run' / 'run_0.mcap').warnings   # and no end yet
    writer.close()
    assert '/imu/data_raw: 7 messages are missing by their stamps' in (
        read(tmp_path / 'run' / 'run_0.mcap').warnings[-1])
    assert 'run_0.mcap: the file breaks off' in warning
    later, = read(tmp_path / 'run' / 'run_1.mcap').warnings
    assert later.endswith('/imu/data_raw: 2 messages were lost by the middleware')
    assert told(tmp_path / 'run')['custom_data'] == {
        'starcal_losses:/imu/data_raw':
        '{"missing_by_stamps": 7, "longest_gap_s": 0.08, "lost_by_middleware": 2}'}
    with (tmp_path / 'run' / 'run_1.mcap').open('rb') as stream:
        assert 'starcal_losses' in {each.name for each in make_reader(stream).iter_metadata()}


def test_a_folder_that_is_removed_is_told(tmp_path):
    folder = tmp_path / 'runs'
    folder.mkdir()
    writer, parts = BagWriter(folder / 'run.mcap'), batches()
    writer.write(next(parts))
    shutil.rmtree(folder)
    with pytest.raises(RecordError, match=r'run\.mcap was removed while it was written'):
        writer.write(next(parts))
    with pytest.raises(RecordError, match='was removed'):
        writer.close()


def test_a_file_that_is_moved_is_written_on(tmp_path):
    writer = BagWriter(tmp_path / 'run.mcap')
    for k, each in enumerate(batches()):
        writer.write(each)
        if k == 3:
            (tmp_path / 'run.mcap').rename(tmp_path / 'moved.mcap')
    writer.close()
    assert len(read(tmp_path / 'moved.mcap').gyro) == 1000


def test_a_disk_that_fills_up_is_warned_of_once_and_the_file_gets_its_end(tmp_path, monkeypatch):
    free = [10**9]
    monkeypatch.setattr(os, 'fstatvfs', lambda descriptor: SimpleNamespace(
        f_bavail=free[0], f_frsize=1))
    writer, parts = BagWriter(tmp_path / 'run.mcap'), batches()
    writer.write(next(parts))
    assert writer.low() == ''
    free[0] = 90 * 10**6
    writer.write(next(parts))
    assert f'{tmp_path} has 90.0 MB left' in writer.low() and writer.low() == ''
    free[0] = 500_000
    with pytest.raises(RecordError, match='is full: 0.5 MB are left, the recording ends here'):
        writer.write(next(parts))
    writer.give_up()
    assert check_file(tmp_path / 'run.mcap').faults == []
    assert len(read(tmp_path / 'run.mcap').gyro) == 200


class Full:
    """A file on a disk with room for so many bytes."""

    def __init__(self, stream, room):
        self._stream, self.room = stream, room

    def __getattr__(self, name):
        return getattr(self._stream, name)

    def __enter__(self):
        return self

    def __exit__(self, *given):
        self._stream.close()

    def write(self, data):
        """Write what there is room for, as the system does."""
        part = data[:max(0, self.room - self._stream.tell())]
        if not part:
            raise OSError(28, os.strerror(28))
        return self._stream.write(part)


@pytest.mark.parametrize('room', [5_000, 9_999, 20_000, 33_000])
def test_what_is_on_a_full_disk_can_be_read(tmp_path, room):
    writer = BagWriter(tmp_path / 'run.mcap')
    inner = writer._writer
    inner._stream = inner._mcap._stream = Full(inner._stream, room)
    written = 0
    with pytest.raises(RecordError, match='No space left on device'):
        for each in batches():
            writer.write(each)
            written += len(each[0].log_time_ns)
    writer.give_up()
    recording = read(tmp_path / 'run.mcap')
    assert len(recording.gyro) == written
    assert len(recording.warnings) <= 1         # that it breaks off, if its end had no room
    assert (tmp_path / 'run.mcap').stat().st_size <= room
