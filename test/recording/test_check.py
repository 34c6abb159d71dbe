# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Every byte of a recording counts: what is changed in one is found."""

import struct

from mcap.opcode import Opcode
import mcap.writer
import numpy as np
import pytest
from rosbags import rosbag2
import yaml

from instruments import EXTERNAL
from starcal_ros.cli import main
from starcal_ros.messages.cdr import RecordError
from starcal_ros.recording.check import check
from starcal_ros.recording.mcap_check import check_file
from starcal_ros.recording.mcap_writer import McapWriter
from written import messages, write, write_with_mcap, write_with_rosbags


def test_a_sound_recording_of_ours_is_sound_and_all_of_it_checked(tmp_path, capsys):
    path = write(tmp_path / 'run.mcap')
    found = check_file(path)
    assert (found.faults, found.unchecked, found.messages) == ([], [], 1020)
    assert main(['info', '--check', str(path)]) == 0
    assert f'sound: 1020 messages in {found.chunks} chunks' in capsys.readouterr().out


def test_one_changed_byte_is_found_wherever_it_is(tmp_path, record_property):
    """200 places, by chance, and the bytes at both ends."""
    path, rng = write(tmp_path / 'run.mcap'), np.random.default_rng(1)
    sound = path.read_bytes()
    places = [*rng.integers(len(sound), size=200).tolist(), 0, 9, *range(len(sound) - 60,
                                                                         len(sound))]
    missed = []
    for place in places:
        damaged = bytearray(sound)
        damaged[place] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            if not check_file(path).faults:
                missed.append(place)
        except RecordError:         # it no longer begins as an MCAP file
            pass
    assert not missed
    record_property('figure', f'{len(places)} of {len(places)} changed bytes are found')


def test_a_fault_is_named_and_has_a_status_of_its_own(tmp_path, capsys):
    path = write(tmp_path / 'run.mcap')
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    path.write_bytes(damaged)
    assert main(['info', '--check', str(path)]) == 4
    out = capsys.readouterr().out
    assert 'fault: run.mcap: the chunk at byte' in out and 'sound' not in out
    assert 'fault: run.mcap: the checksum of the data section is wrong' in out


@pytest.mark.parametrize('compression', mcap.writer.CompressionType)
def test_what_the_library_of_mcap_writes_is_sound(tmp_path, compression):
    path = write_with_mcap(tmp_path / 'run.mcap', messages(), compression=compression)
    assert check_file(path).faults == []


def test_what_others_recorded_is_sound_and_its_missing_checksums_are_told(capsys):
    if not EXTERNAL.exists():
        pytest.skip('the external recording lies beside the checkout, and is not there')
    assert main(['info', '--check', str(EXTERNAL)]) == 0
    assert 'without checksums in external_tan2018.mcap: chunks, the data section' in (
        capsys.readouterr().out)


@pytest.mark.parametrize('storage', [*rosbag2.StoragePlugin])
def test_the_counts_of_metadata_are_checked(tmp_path, storage):
    path = write_with_rosbags(tmp_path / 'bag', messages(), storage_plugin=storage)
    assert not any(found.faults for found in check(path).values())
    tree = yaml.safe_load((path / 'metadata.yaml').read_text())
    tree['rosbag2_bagfile_information']['message_count'] = 7
    (path / 'metadata.yaml').write_text(yaml.safe_dump(tree))
    assert check(path)['metadata.yaml'].faults == ['says 7 messages, the files hold 1020']


def test_a_damaged_database_is_found(tmp_path):
    path = write_with_rosbags(tmp_path / 'bag', messages(),
                              storage_plugin=rosbag2.StoragePlugin.SQLITE3)
    file, = path.glob('*.db3')
    content = bytearray(file.read_bytes())
    content[8192:8292] = bytes(100)
    file.write_bytes(content)
    assert check_file_of(path)


def check_file_of(path):
    """Return the faults of the first file of a bag."""
    return next(iter(check(path).values())).faults


def test_a_type_that_cannot_be_parsed_and_a_wrong_count_are_found(tmp_path):
    path = tmp_path / 'run.mcap'
    with path.open('wb', buffering=0) as stream:
        writer = McapWriter(stream, 'ros2', 'test')
        schema = writer.add_schema('a_msgs/msg/A', 'ros2msg', b'float64 ]x[\n')
        writer.add_message(writer.add_channel('/a', 'cdr', schema, {}), 1, 1, b'\0\1\0\0')
        writer._counts[1] = 3
        writer.finish()
    faults = check_file(path).faults
    assert any('the definition of a_msgs/msg/A cannot be parsed' in text for text in faults)
    assert '1 messages are found, the statistics say 3' in faults


def test_a_file_without_its_end_is_said_to_have_none(tmp_path):
    path = write(tmp_path / 'run.mcap')
    footer = path.read_bytes().rindex(struct.pack('<BQ', 2, 20))
    path.write_bytes(path.read_bytes()[:footer])
    assert any('breaks off' in text for text in check_file(path).faults)


def test_a_file_whose_data_do_not_end_is_said_so(tmp_path):
    """The opcode of the record that ends them is another's: found by `bench/fuzz.py`."""
    path = write(tmp_path / 'run.mcap')
    content = path.read_bytes()
    at = content.rindex(bytes([Opcode.DATA_END]) + struct.pack('<Q', 4))
    path.write_bytes(content[:at] + b'\x7f' + content[at + 1:])
    assert 'the data section has no end' in check_file(path).faults
