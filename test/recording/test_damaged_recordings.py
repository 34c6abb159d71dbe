# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings that are broken in every way: read as far as they go, or an error in one line."""

from mcap.reader import make_reader
import numpy as np
import pytest
from rosbags import rosbag2

from starcal_ros.recording.reader import RecordError, read, summary
from written import FRAMES, GYRO, assert_same, messages, write, write_with_mcap, write_with_rosbags


def test_a_broken_message_is_an_error_that_names_its_topic(tmp_path):
    rows = [(topic, kind, t, data[:50] if t == GYRO.stamp_ns[77] else data)
            for topic, kind, t, data in messages()]
    with pytest.raises(RecordError, match='/imu/data_raw: a message of 50 bytes is cut short'):
        read(write_with_mcap(tmp_path / 'run.mcap', rows))


@pytest.mark.parametrize('content, message', [
    (None, 'does not exist'), (b'', 'it has 0 bytes'), (b'abc', 'it has 3 bytes'),
    (bytes(1000), 'is not an MCAP file: it starts with'),
    (b'SQLite format 3\0' + bytes(100), 'is not an MCAP file'),
    (b'\x89MCAP0\r\n', 'has no topic /imu/data_raw; it has no topics'),
    (b'\x89MCAP0\r\n' + bytes(range(1, 256)), 'it has no topics')])
def test_what_is_no_recording_is_an_error_in_one_line(tmp_path, content, message):
    path = tmp_path / 'run.mcap'
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RecordError, match=message) as caught:
        read(path)
    assert '\n' not in str(caught.value) and str(path) in str(caught.value)


@pytest.mark.parametrize('metadata, message', [
    ('{', 'cannot be read as the metadata of a rosbag2 directory'),
    ('a: 1', "KeyError 'rosbag2_bagfile_information'"),
    ('rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: [gone.mcap]}',
     'names files that are missing: gone.mcap'),
    ('rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: ['
     + 'x' * 400 + ']}', 'names files that are missing: xxx'),
    ('rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: []}',
     'names no files'),
    ('rosbag2_bagfile_information: {storage_identifier: tape, relative_file_paths: [run.mcap]}',
     'cannot be read')])
def test_a_directory_that_is_no_bag_is_an_error_in_one_line(tmp_path, metadata, message):
    write(tmp_path / 'run.mcap')
    (tmp_path / 'metadata.yaml').write_text(metadata)
    with pytest.raises(RecordError, match=message) as caught:
        read(tmp_path)
    assert '\n' not in str(caught.value)


def test_a_broken_database_is_an_error_in_one_line(tmp_path):
    path = write_with_rosbags(tmp_path / 'bag', messages(),
                              storage_plugin=rosbag2.StoragePlugin.SQLITE3)
    database = path / 'bag.db3'
    database.write_bytes(database.read_bytes()[:5000])
    with pytest.raises(RecordError, match='cannot be read') as caught:
        read(path)
    assert '\n' not in str(caught.value)


def test_a_file_cut_anywhere_is_read_as_far_as_it_goes(tmp_path):
    whole = write(tmp_path / 'run.mcap').read_bytes()
    cut = tmp_path / 'cut.mcap'
    kept = []
    for size in np.linspace(len(whole) // 5, len(whole) - 9, 60).astype(int):
        cut.write_bytes(whole[:size])
        recording = read(cut)
        assert any('breaks off at byte' in text for text in recording.warnings)
        assert_same(recording.gyro, GYRO[:len(recording.gyro)])
        assert_same(recording.frames, FRAMES[:len(recording.frames)])
        kept.append(len(recording.gyro))
    assert kept == sorted(kept) and kept[0] > 100 and kept[-1] == len(GYRO)


def test_a_cut_file_without_chunks_keeps_every_whole_message(tmp_path):
    path = write_with_mcap(tmp_path / 'run.mcap', messages(), use_chunking=False)
    path.write_bytes(path.read_bytes()[:200_000])
    recording = read(path)
    assert 500 < len(recording.gyro) < len(GYRO)
    assert_same(recording.gyro, GYRO[:len(recording.gyro)])


def test_a_damaged_chunk_is_left_out_and_named(tmp_path):
    path = write(tmp_path / 'run.mcap')
    with path.open('rb') as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[4]
    data = bytearray(path.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length - 20] ^= 0xff
    path.write_bytes(data)
    recording = read(path)
    inside = ((GYRO.stamp_ns >= chunk.message_start_time)
              & (GYRO.stamp_ns <= chunk.message_end_time))
    np.testing.assert_array_equal(recording.gyro.rate, GYRO.rate[~inside])
    damaged, gyro_lost, frames_lost = recording.warnings
    assert f'the chunk at byte {chunk.chunk_start_offset} is left out' in damaged
    assert gyro_lost == f'{(~inside).sum()} of 1000 messages on /imu/data_raw could be read'
    assert frames_lost.endswith('of 20 messages on /star_tracker/centroids could be read')


def indexed(folder):
    """Return a recording, what it holds, and where the message index of its fifth chunk begins."""
    path = write(folder / 'run.mcap')
    with path.open('rb') as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[4]
    return path, bytearray(path.read_bytes()), chunk.chunk_start_offset + chunk.chunk_length + 9


def test_a_wrong_message_index_is_replaced_by_a_scan(tmp_path):
    path, data, index = indexed(tmp_path)
    index += 6
    data[index + 8:index + 16] = (12345).to_bytes(8, 'little')
    path.write_bytes(data)
    recording = read(path)
    assert_same(recording.gyro, GYRO)
    warning, = recording.warnings
    assert 'the message index is wrong' in warning


def test_messages_that_the_index_leaves_out_are_missed_by_the_statistics(tmp_path):
    path, data, index = indexed(tmp_path)
    index += 2
    n_bytes = int.from_bytes(data[index:index + 4], 'little')
    data[index:index + 4] = (n_bytes - 16).to_bytes(4, 'little')
    path.write_bytes(data)
    warning, = read(path).warnings
    assert "by the file's statistics /imu/data_raw has 1000 messages, by its chunks 999" in warning


def test_random_damage_costs_data_and_a_warning_or_is_an_error_in_one_line(tmp_path):
    rng = np.random.default_rng(8)
    whole = np.frombuffer(write(tmp_path / 'run.mcap').read_bytes(), np.uint8)
    path = tmp_path / 'damaged.mcap'
    for _ in range(300):
        data = whole.copy()
        data[rng.integers(8, len(data), 4)] = rng.integers(0, 256, 4)
        path.write_bytes(data)
        try:
            recording = read(path)
            summary(path)
        except RecordError:
            continue
        assert np.isin(recording.gyro.stamp_ns, GYRO.stamp_ns).all()
        assert recording.warnings or len(recording.gyro) == len(GYRO)


def test_a_damaged_attachment_is_left_out(tmp_path):
    path = write(tmp_path / 'run.mcap')
    path.write_bytes(path.read_bytes().replace(b'a: 1\n', b'a: 7\n'))
    recording = read(path)
    assert set(recording.attachments) == {'truth.json'}
    assert 'is garbled and left out' in recording.warnings[0]
