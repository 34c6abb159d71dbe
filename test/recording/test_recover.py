# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a killed recorder or a power cut leaves is finished, and stock readers take it."""

import json

from mcap.reader import make_reader
import numpy as np
import pytest
from rosbags import rosbag2
import yaml

from instruments import TAN2018
from starcal_ros.cli import main
from starcal_ros.messages.cdr_imu import IMU_TYPE
from starcal_ros.recording.mcap_check import check_file
from starcal_ros.recording.reader import FRAMES_TOPIC, GYRO_TOPIC, read
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch
from starcal_ros.simulation.write_recording import simulate
from written import (FRAMES, GYRO, START_NS, assert_holds_all, messages, write, write_with_mcap,
                     write_with_rosbags)

COUNTS = {GYRO_TOPIC: len(GYRO), FRAMES_TOPIC: len(FRAMES)}


def killed(path):
    """Write a recording as a recorder leaves it that is killed."""
    writer = Writer(path)
    writer.attach('config.yaml', b'a: 1\n', 'application/yaml')
    writer.write_batches(imu_batch(GYRO_TOPIC, GYRO), centroids_batch(FRAMES_TOPIC, FRAMES))
    writer.flush()
    content = path.read_bytes()
    writer.close()
    path.write_bytes(content)
    return path


def by_mcap(path):
    """Return the counts of the topics by the library of MCAP, and check the types."""
    with path.open('rb') as stream:
        found = [(schema.name, channel.topic) for schema, channel, _ in
                 make_reader(stream, validate_crcs=True).iter_messages()]
        assert (IMU_TYPE, GYRO_TOPIC) in found
        return {topic: sum(each == topic for _, each in found) for topic in
                (GYRO_TOPIC, FRAMES_TOPIC)}


def by_rosbags(path):
    """Return the same by rosbags, from the messages themselves."""
    with rosbag2.Reader(path) as bag:
        found = [connection.topic for connection, _, _ in bag.messages()]
        assert sum(c.msgcount for c in bag.connections) == len(found)
        return {topic: found.count(topic) for topic in (GYRO_TOPIC, FRAMES_TOPIC)}


def refused(path):
    """Tell whether stock readers get nothing from a file."""
    with path.open('rb') as stream:
        try:
            count = sum(1 for _ in make_reader(stream).iter_messages())
        except Exception:
            count = 0
    with pytest.raises(rosbag2.ReaderError):
        by_rosbags(path)
    return count == 0


def test_what_a_killed_recorder_left_is_finished_for_every_reader(tmp_path, capsys):
    path = killed(tmp_path / 'run.mcap')
    content = path.read_bytes()
    assert refused(path)
    assert main(['recover', str(path)]) == 0
    assert ('run.mcap: 1020 messages in 11 chunks recovered; lost: nothing that was in the file'
            in capsys.readouterr().out)
    assert by_mcap(path) == by_rosbags(path) == COUNTS
    recording = read(path)
    assert_holds_all(recording)
    assert recording.attachments == {'config.yaml': b'a: 1\n'}
    found = check_file(path)
    assert (found.faults, found.unchecked) == ([], [])
    assert (tmp_path / 'run.mcap.orig').read_bytes() == content


def test_a_file_that_is_cut_anywhere_gives_all_that_is_whole_and_what_is_lost(
        tmp_path, record_property):
    whole = killed(tmp_path / 'whole.mcap').read_bytes()
    before = 0
    sizes = np.linspace(2000, len(whole), 40).astype(int).tolist()
    for size in sizes:
        path, out = tmp_path / 'run.mcap', tmp_path / 'out.mcap'
        path.write_bytes(whole[:size])
        expected = read(path, needs_gyro=False) if size > 12_000 else None
        status = main(['recover', str(path), '--out', str(out), '--overwrite'])
        if status == 1:
            assert before == 0 and not out.exists()
            continue
        assert status == 0 and path.read_bytes() == whole[:size]
        assert not check_file(out).faults
        assert by_mcap(out) == by_rosbags(out)
        assert sum(by_mcap(out).values()) >= before
        before = sum(by_mcap(out).values())
        if expected is not None:
            assert by_mcap(out) == {GYRO_TOPIC: len(expected.gyro),
                                    FRAMES_TOPIC: len(expected.frames)}
    assert before == 1020
    record_property('figure', f'cut at {len(sizes)} places, no whole chunk is lost, and mcap and '
                    'rosbags read each result')


def test_damage_inside_costs_its_chunk_alone_and_readers_are_told(tmp_path, capsys):
    path = write(tmp_path / 'run.mcap')
    content = bytearray(path.read_bytes())
    chunks = [at - 37 for at in range(len(content)) if content[at:at + 8] == b'\4\0\0\0zstd']
    content[chunks[4] + 1000] ^= 1      # in its data
    content[chunks[7] + 6] ^= 1         # in its length
    path.write_bytes(content)
    out = tmp_path / 'out.mcap'
    assert main(['recover', str(path), '--out', str(out), '--json']) == 0
    result, = json.loads(capsys.readouterr().out)['files']
    assert (result['lost_chunks'], result['lost_messages']) == (1, 102)
    assert result['lost_bytes'] > 1000 and result['messages'] == 1020 - 204
    assert not check_file(out).faults and sum(by_mcap(out).values()) == 816
    assert [text for text in read(out).warnings if 'when it was recovered, 1 damaged chunks' in
            text]


def test_what_the_first_chunk_declared_is_known_without_it(tmp_path):
    """Of a finished file the summary has it; every reader gets the topics of the rest."""
    path = write(tmp_path / 'run.mcap')
    content = bytearray(path.read_bytes())
    content[content.index(b'\4\0\0\0zstd') + 900] ^= 1
    path.write_bytes(content)
    assert main(['recover', str(path)]) == 0
    assert by_mcap(path) == by_rosbags(path)
    assert sum(by_mcap(path).values()) > 900


@pytest.mark.parametrize('chunks', [True, False])
def test_recordings_of_others_are_finished(tmp_path, chunks):
    path = write_with_mcap(tmp_path / 'run.mcap', messages(), use_chunking=chunks,
                           chunk_size=20_000)
    content = path.read_bytes()
    path.write_bytes(content[:int(len(content) * 0.6)])
    count = sum(map(len, (read(path).gyro, read(path).frames)))
    assert main(['recover', str(path)]) == 0
    assert sum(by_mcap(path).values()) == sum(by_rosbags(path).values()) == count > 500
    assert not check_file(path).faults


def test_a_sound_recording_stays_as_it_is(tmp_path, capsys):
    path = write(tmp_path / 'run.mcap')
    content = path.read_bytes()
    assert main(['recover', str(path)]) == 0
    assert 'run.mcap: sound, 1020 messages' in capsys.readouterr().out
    assert path.read_bytes() == content and [*tmp_path.iterdir()] == [path]


def test_nothing_in_the_way_is_replaced_without_being_told_to(tmp_path, capsys):
    path, out = killed(tmp_path / 'run.mcap'), tmp_path / 'out.mcap'
    out.write_text('mine')
    assert main(['recover', str(path), '--out', str(out)]) == 2
    assert main(['recover', str(path), '--out', str(path), '--overwrite']) == 2
    assert out.read_text() == 'mine'
    (tmp_path / 'run.mcap.orig').write_text('mine, too')
    assert main(['recover', str(path)]) == 2
    assert 'run.mcap.orig exists' in capsys.readouterr().err
    assert (tmp_path / 'run.mcap.orig').read_text() == 'mine, too'


def test_a_directory_replaces_a_recording_alone_and_not_itself(tmp_path, capsys):
    path, out = directory(tmp_path / 'bag'), tmp_path / 'out'
    names = sorted(each.name for each in path.iterdir())
    for target in (path, tmp_path):
        assert main(['recover', str(path), '--out', str(target), '--overwrite']) == 2
        assert f'{target} exists' in capsys.readouterr().err
    assert sorted(each.name for each in path.iterdir()) == names
    assert main(['recover', str(path), '--out', str(out)]) == 0
    assert main(['recover', str(path), '--out', str(out)]) == 2
    assert main(['recover', str(path), '--out', str(out), '--overwrite']) == 0
    (out / 'mine.txt').write_text('mine')
    assert main(['recover', str(path), '--out', str(out), '--overwrite']) == 2
    assert sorted(each.name for each in tmp_path.iterdir()) == ['bag', 'out']


@pytest.mark.parametrize('content, status', [(b'\x89MCAP0\r\n', 1), (b'no recording', 2)])
def test_what_holds_nothing_is_refused(tmp_path, content, status, capsys):
    path = tmp_path / 'run.mcap'
    path.write_bytes(content)
    assert main(['recover', str(path), '--out', str(tmp_path / 'out.mcap')]) == status
    assert capsys.readouterr().err.startswith('starcal recover: error: ')
    assert [*tmp_path.iterdir()] == [path]


def directory(folder):
    """Make what a power cut leaves of a split recording: no metadata, the last file cut short."""
    folder.mkdir()
    middle = START_NS + 5 * 10**9
    for k, part in enumerate((GYRO.stamp_ns <= middle, GYRO.stamp_ns > middle)):
        frames = (FRAMES.stamp_ns <= middle) if k == 0 else (FRAMES.stamp_ns > middle)
        write(folder / f'run_{k}.mcap', type(GYRO)(GYRO.stamp_ns[part], GYRO.rate[part]),
              FRAMES.take(np.flatnonzero(frames)))
    last = folder / 'run_1.mcap'
    last.write_bytes(last.read_bytes()[:20_000])
    (folder / 'run_2.mcap').write_bytes(bytes(4096))
    (folder / 'metadata.yaml').write_bytes(bytes(100))
    return folder


@pytest.mark.parametrize('elsewhere', [False, True])
def test_a_directory_after_a_power_cut_is_read_whole_and_gets_its_metadata(
        tmp_path, monkeypatch, elsewhere, capsys):
    path = directory(tmp_path / 'bag')
    before = read(path)
    assert any('run_2.mcap is empty' in text for text in before.warnings)
    monkeypatch.setenv('ROS_DISTRO', 'kilted')
    out = tmp_path / 'out' if elsewhere else path
    assert main(['recover', str(path), *(['--out', str(out)] if elsewhere else [])]) == 0
    told = yaml.safe_load((out / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    counts = by_rosbags(out)
    assert counts == {GYRO_TOPIC: len(before.gyro), FRAMES_TOPIC: len(before.frames)}
    assert (told['version'], told['storage_identifier'], told['ros_distro']) == (
        9, 'mcap', 'kilted')
    assert told['relative_file_paths'] == ['run_0.mcap', 'run_1.mcap']
    assert [each['path'] for each in told['files']] == told['relative_file_paths']
    assert sum(each['message_count'] for each in told['files']) == told['message_count']
    assert {each['topic_metadata']['name']: each['message_count']
            for each in told['topics_with_message_count']} == counts
    assert told['files'][0]['starting_time'] == told['starting_time']
    after = read(out)
    warning, = after.warnings
    assert len(after.gyro) == len(before.gyro) < 1000
    assert warning.startswith('run_1.mcap: when it was recovered, ')
    assert main(['info', '--check', str(out)]) == 0
    with rosbag2.Reader(out) as bag:
        assert bag.ros_distro == 'kilted'
        assert bag.connections[0].ext.offered_qos_profiles[0].depth == 100


def test_metadata_are_those_that_rosbag2_writes(tmp_path):
    """Same keys in the same places as a directory of rosbags, which follows rosbag2."""
    path = directory(tmp_path / 'bag')
    assert main(['recover', str(path)]) == 0
    other = write_with_rosbags(tmp_path / 'other', messages(),
                               storage_plugin=rosbag2.StoragePlugin.MCAP)

    def keys(value):
        if isinstance(value, dict):
            return {key: keys(each) for key, each in value.items() if key != 'custom_data'}
        return keys(value[0]) if isinstance(value, list) and value else type(value)
    ours, theirs = (yaml.safe_load((each / 'metadata.yaml').read_text()) for each in (path, other))
    theirs['rosbag2_bagfile_information']['topics_with_message_count'][0]['topic_metadata'][
        'offered_qos_profiles'] = ours['rosbag2_bagfile_information'][
            'topics_with_message_count'][0]['topic_metadata']['offered_qos_profiles']
    assert keys(ours) == keys(theirs)


def test_a_single_file_tells_its_distribution_to_rosbag2(tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_DISTRO', 'jazzy')
    with write(tmp_path / 'run.mcap').open('rb') as stream:
        record, = make_reader(stream).iter_metadata()
    told = yaml.safe_load(record.metadata['serialized_metadata'])
    assert (record.name, told['ros_distro'], told['message_count']) == ('rosbag2', 'jazzy', 1020)


@pytest.mark.parametrize('known', ['jazzy', ''])
def test_a_recovered_file_tells_its_distribution_to_rosbag2(tmp_path, monkeypatch, known):
    """That which it tells where it begins, as rosbag2 writes it, or that of the machine."""
    path = tmp_path / 'run.mcap'
    with Writer(path) as writer:
        if known:
            writer.note('rosbag2', {'serialized_metadata': f'ros_distro: {known}'})
        writer.write_imu(GYRO_TOPIC, GYRO)
    path.write_bytes(path.read_bytes()[:-3000])
    monkeypatch.setenv('ROS_DISTRO', 'kilted')
    assert main(['recover', str(path)]) == 0
    with path.open('rb') as stream:
        record, = (each for each in make_reader(stream).iter_metadata() if each.name == 'rosbag2')
    told = yaml.safe_load(record.metadata['serialized_metadata'])
    assert told['ros_distro'] == (known or 'kilted')
    assert told['message_count'] == by_rosbags(path)[GYRO_TOPIC] > 0
    assert told['relative_file_paths'] == ['run.mcap']


def test_a_recovered_recording_is_calibrated(tmp_path):
    path = tmp_path / 'run.mcap'
    simulate(TAN2018.replace({'simulation.duration_s': 20.0}), path)
    path.write_bytes(path.read_bytes()[:-3000])
    assert main(['recover', str(path)]) == 0
    assert main(['calibrate', str(path), '--out', str(tmp_path / 'result.json')]) in (0, 3)
    assert json.loads((tmp_path / 'result.json').read_text())['counts']['gyro'] > 1500


def test_sqlite3_is_left_to_rosbag2(tmp_path, capsys):
    path = write_with_rosbags(tmp_path / 'bag', messages(),
                              storage_plugin=rosbag2.StoragePlugin.SQLITE3)
    assert main(['recover', str(path)]) == 2
    assert f'ros2 bag reindex {path}' in capsys.readouterr().err
