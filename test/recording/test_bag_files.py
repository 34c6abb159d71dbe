# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings without metadata, with wrong ones, and files that are known but not read."""

import bz2
import gzip
import lzma
import os
import shlex
import shutil
import sqlite3

import lz4.frame
import mcap.writer
import pytest
from rosbags import rosbag2
from rosbags.convert.cli import PARSER
import yaml
import zstandard

from starcal_ros.cli import main
from starcal_ros.files.limits import CHUNK
from starcal_ros.messages.cdr import RecordError
from starcal_ros.recording.reader import FRAMES_TOPIC, GYRO_TOPIC, read, summary
from written import assert_holds_all, messages, split, write, write_with_mcap, write_with_rosbags

STORAGES = [*rosbag2.StoragePlugin]


def edit(path, **changes):
    """Change the metadata of a bag."""
    file = path / 'metadata.yaml'
    tree = yaml.safe_load(file.read_text())
    tree['rosbag2_bagfile_information'].update(changes)
    file.write_text(yaml.safe_dump(tree))


@pytest.mark.parametrize('storage', STORAGES)
@pytest.mark.parametrize('given', ['', None])
def test_a_storage_that_is_left_open_is_that_of_the_files(tmp_path, storage, given):
    path = write_with_rosbags(tmp_path / 'bag', messages(), storage_plugin=storage)
    edit(path, storage_identifier=given)
    assert_holds_all(read(path))


@pytest.mark.parametrize('storage', STORAGES)
def test_metadata_of_a_newer_version_are_read(tmp_path, storage):
    path = write_with_rosbags(tmp_path / 'bag', messages(), storage_plugin=storage)
    edit(path, version=23, new_entry={'a': 1})
    assert_holds_all(read(path))


@pytest.mark.parametrize('storage', STORAGES)
def test_counts_are_those_of_the_files(tmp_path, storage):
    path = write_with_rosbags(tmp_path / 'bag', messages(), storage_plugin=storage)
    tree = yaml.safe_load((path / 'metadata.yaml').read_text())
    for topic in tree['rosbag2_bagfile_information']['topics_with_message_count']:
        topic['message_count'] = 3
    (path / 'metadata.yaml').write_text(yaml.safe_dump(tree))
    assert_holds_all(read(path))
    assert {row.topic: row.count for row in summary(path).topics} == {
        GYRO_TOPIC: 1000, FRAMES_TOPIC: 20}


@pytest.mark.parametrize('left', [None, '', ' \n'])
def test_a_split_recording_without_metadata_is_read_in_the_order_of_its_numbers(tmp_path, left):
    names = [f'run_{k}.mcap' for k in range(11)]
    path = split(tmp_path / 'bag', names)
    (path / 'metadata.yaml').unlink()
    if left is not None:
        (path / 'metadata.yaml').write_text(left)
    recording = read(path)
    assert_holds_all(recording, recording.warnings)
    warning, = recording.warnings
    assert ', '.join(names) in warning
    assert f'starcal recover {path}' in warning
    assert main(['info', str(path)]) == 0


@pytest.mark.parametrize('compressed', [False, True])
@pytest.mark.parametrize('storage', STORAGES)
def test_one_file_without_metadata_is_read(tmp_path, storage, compressed):
    def prepare(bag):
        if compressed:
            bag.set_compression(rosbag2.CompressionMode.FILE, rosbag2.CompressionFormat.ZSTD)
    path = write_with_rosbags(tmp_path / 'bag', messages(), prepare, storage_plugin=storage)
    (path / 'metadata.yaml').unlink()
    recording = read(path)
    assert_holds_all(recording, recording.warnings)
    assert len(recording.warnings) == 1


@pytest.mark.parametrize('names', [('a.mcap', 'b.mcap'), ('a_0.mcap', 'b_1.mcap'),
                                   ('a_1.mcap', 'a_01.mcap')])
def test_files_of_several_recordings_are_not_taken_for_one(tmp_path, names):
    path = split(tmp_path / 'bag', names)
    (path / 'metadata.yaml').unlink()
    with pytest.raises(RecordError, match='can be read one by one: ' + ', '.join(sorted(names))):
        read(path)


def test_a_split_database_is_read(tmp_path):
    path = write_with_rosbags(tmp_path / 'bag', messages(),
                              storage_plugin=rosbag2.StoragePlugin.SQLITE3)
    (path / 'metadata.yaml').unlink()
    shutil.copy(path / 'bag.db3', path / 'bag_1.db3')
    (path / 'bag.db3').rename(path / 'bag_0.db3')
    middle = sorted(time_ns for _, _, time_ns, _ in messages())[510]
    for name, sign in (('bag_0.db3', '>='), ('bag_1.db3', '<')):
        with sqlite3.connect(path / name) as database:
            database.execute(f'DELETE FROM messages WHERE timestamp {sign} {middle}')
    recording = read(path)
    assert_holds_all(recording, recording.warnings)


def test_messages_without_a_schema_are_read_by_the_names_of_their_topics(tmp_path):
    path = tmp_path / 'run.mcap'
    with path.open('wb') as stream:
        writer = mcap.writer.Writer(stream)
        writer.start('ros2', 'test')
        channels = {name: writer.register_channel(name, 'cdr', 0)
                    for name in (GYRO_TOPIC, FRAMES_TOPIC)}
        for topic, _, log_time, data in messages():
            writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()
    assert_holds_all(read(path), tuple(
        f'{name} has no schema: its name is believed' for name in (GYRO_TOPIC, FRAMES_TOPIC)))


def converts(text):
    """Check that the command in a message is one that rosbags-convert takes."""
    command = text[text.index('rosbags-convert'):]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, 'access', lambda *given: True)
        words = shlex.split(command)
        assert words[1::2] == ['--src', '--dst']
        assert {'--src', '--dst'} <= {option for action in PARSER._actions
                                      for option in action.option_strings}


@pytest.mark.parametrize('inside', [False, True])
def test_a_bag_of_ROS_1_is_named_with_its_converter(capsys, tmp_path, inside):
    path = tmp_path / 'my run.bag'
    path.write_bytes(b'#ROSBAG V2.0\n' + bytes(100))
    for command in ('info', 'intrinsics'):
        assert main([command, str(tmp_path if inside else path)]) == 2
        line = capsys.readouterr().err.splitlines()[-1]
        assert f'{path} is a bag of ROS 1' in line
        converts(line)


def test_an_MCAP_of_ROS_1_is_named_with_its_converter(capsys, tmp_path):
    path = tmp_path / 'run.mcap'
    with path.open('wb') as stream:
        writer = mcap.writer.Writer(stream)
        writer.start('ros1', 'test')
        schema = writer.register_schema('sensor_msgs/Imu', 'ros1msg', b'')
        channel = writer.register_channel(GYRO_TOPIC, 'ros1', schema)
        writer.add_message(channel, 1, b'abc', 1)
        writer.finish()
    with pytest.raises(RecordError, match='is an MCAP file with messages of ROS 1') as caught:
        read(path)
    converts(str(caught.value))
    assert main(['info', str(path)]) == 0 and 'sensor_msgs/Imu' in capsys.readouterr().out


@pytest.mark.parametrize('suffix, pack, command', [
    ('.mcap.zst', zstandard.ZstdCompressor().compress, 'zstd -d'),
    ('.mcap.lz4', lz4.frame.compress, 'lz4 -d'), ('.mcap.gz', gzip.compress, 'gunzip -k'),
    ('.mcap.bz2', bz2.compress, 'bunzip2 -k'), ('.mcap', lzma.compress, 'unxz -k')])
def test_a_file_compressed_as_a_whole_is_named_with_what_unpacks_it(tmp_path, suffix, pack,
                                                                    command):
    path = tmp_path / f'run{suffix}'
    path.write_bytes(pack(write(tmp_path / 'sound.mcap').read_bytes()))
    with pytest.raises(RecordError, match=f'is compressed as a whole .*: {command} {path}$'):
        read(path)


def test_a_pipe_is_no_recording(tmp_path):
    os.mkfifo(tmp_path / 'run.mcap')
    with pytest.raises(RecordError, match='is no file'):
        read(tmp_path / 'run.mcap')


@pytest.mark.parametrize('storage', STORAGES)
def test_compressed_messages_are_bounded(tmp_path, monkeypatch, storage):
    rows = messages()
    rows[5] = (*rows[5][:3], bytes(3_000_000))
    if storage is rosbag2.StoragePlugin.MCAP:
        path = tmp_path / 'bag'
        path.mkdir()
        write_with_mcap(path / 'bag.mcap', [
            (*row[:3], zstandard.ZstdCompressor().compress(row[3])) for row in rows])
        (path / 'metadata.yaml').write_text(yaml.safe_dump({'rosbag2_bagfile_information': {
            'version': 9, 'storage_identifier': 'mcap', 'compression_mode': 'MESSAGE',
            'relative_file_paths': ['bag.mcap']}}))
    else:
        path = write_with_rosbags(
            tmp_path / 'bag', rows, storage_plugin=storage,
            prepare=lambda bag: bag.set_compression(rosbag2.CompressionMode.MESSAGE,
                                                    rosbag2.CompressionFormat.ZSTD))
    monkeypatch.setenv(CHUNK.variable, '2')
    with pytest.raises(RecordError, match='a compressed message cannot be unpacked: .*3 MB, at'):
        read(path)
