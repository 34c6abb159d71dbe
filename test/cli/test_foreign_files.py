# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What recordings, tables and names hold is shown as it stands, and never a traceback."""

import errno
import json
import os
import subprocess
import sys

import pytest

from instruments import CONFIG, TAN2018, TOP
from starcal_ros.cli import main
from starcal_ros.config import parameter_file
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch
from starcal_ros.results.attached_truth import attached_truth
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

GYRO, FRAMES = sensors.gyro(TAN2018).next(1000), sensors.star_tracker(TAN2018).next(20)
TRUTH = Truth.from_scenario(TAN2018).as_dict()
HOSTILE = ['[/x]', '[red]', '\x1b]0;title\x07', '\x1b[2J', '[link=file:///]', 'a\nb', '[[', '\\[/']


def write(path, prefix='', truth=None):
    """Write a recording with some topics and some truth."""
    with Writer(path) as writer:
        if truth is not None:
            writer.attach('truth.json', truth, 'application/json')
        writer.write_batches(imu_batch(prefix + '/imu/data_raw', GYRO),
                             centroids_batch(prefix + '/star_tracker/centroids', FRAMES))
    return path


@pytest.mark.parametrize('text', HOSTILE)
def test_topics_and_paths_are_shown_as_they_stand(capsys, tmp_path, text):
    name = text.replace('/', '|')
    path = write(tmp_path / f'{name}.mcap', '/' + text)
    shown = text.replace('\x1b', '\\x1b').replace('\x07', '\\x07').replace('\n', '\\n')
    assert main(['info', str(path)]) == 0
    out, err = capsys.readouterr()
    assert f'/{shown}/imu/data_raw' in out and '\x1b' not in out + err
    config = ['--config', str(CONFIG)]
    assert main(['calibrate', str(path), *config, '--out', str(tmp_path / 'r.json'), '--report',
                 str(tmp_path / 'r.html')]) == 3
    out, err = capsys.readouterr()
    assert '\x1b]' not in out + err and '\x1b[2J' not in out + err
    assert main(['intrinsics', str(path), *config, '--method', 'bundle']) in (1, 3)
    assert main(['info', str(tmp_path / (text + '.gone'))]) == 2


VALUES = [b'', b'{', b'[]', b'null', b'7', b'"x"', b'\xff', b'[' * 100_000, b'{}',
          b'{"mounting": []}', b'9' * 5000,
          *(json.dumps({**TRUTH, key: value}).encode() for key in TRUTH for value in (
              None, [], {}, 'x', [0, 0, 0], ['a'] * 3, [float('nan')] * 3, [10**400] * 3)),
          json.dumps({**TRUTH, 'mounting': {**TRUTH['mounting'],
                                            'quaternion_xyzw': [0, 0, 0, 0]}}).encode()]


@pytest.mark.parametrize('truth', VALUES, ids=range(len(VALUES)))
def test_a_truth_of_any_shape_is_left_out_with_a_notice(truth):
    found, notices = attached_truth({'truth.json': truth})
    if truth == json.dumps({**TRUTH, 'gyro_bias_deg_h': [0, 0, 0]}).encode():
        assert found == {**TRUTH, 'gyro_bias_deg_h': [0.0, 0.0, 0.0]} and not notices
    else:
        assert found is None and len(notices) == 1
        assert notices[0].startswith("the recording's truth.json is left out: ")


def test_the_truth_that_is_written_is_read():
    assert attached_truth({'truth.json': json.dumps(TRUTH).encode()}) == (TRUTH, [])
    assert attached_truth({}) == (None, [])


@pytest.mark.parametrize('command', ['calibrate', 'intrinsics'])
@pytest.mark.parametrize('truth', [b'', b'[1]', b'{"mounting": []}'])
def test_commands_do_without_such_a_truth(capsys, tmp_path, command, truth):
    path = write(tmp_path / 'run.mcap', truth=truth)
    words = ['--report', str(tmp_path / 'r.html')] if command == 'calibrate' else []
    assert main([command, str(path), '--config', str(CONFIG), '--out', str(tmp_path / 'r.json'),
                 *words]) in (1, 3)
    out, err = capsys.readouterr()
    assert ("warning: the recording's truth.json is left out: " in err
            or 'no camera from' in err) and 'error/sigma' not in out


def test_a_table_that_is_not_UTF_8_is_named(capsys, tmp_path):
    table = tmp_path / 'stars.csv'
    words = ['intrinsics', '--centroids', str(table), '--width', '9', '--height', '9']
    for content, message in (
            (b'image,u,v,catalog_id\nN\xe4,1,2,3\n', f'{table}: is not UTF-8: byte 22 is 0xe4'),
            ('image,u,v,catalog_id\na,1,2,3\n'.encode('utf-16'), 'is not UTF-8'),
            (b'image,u,v,catalog_id\n' + b'"' + b'a' * 200_000, f'{table}: not CSV'),
            (b'image,u,v,catalog_id\na,1,2,' + b'9' * 400, f'{table}, line 2: got'),
            (b'image,u,v,catalog_id\na,nan,2,3\n', f'{table}, line 2: got'),
            (b'image,u,v,catalog_id\na,1e999,2,3\n', f'{table}, line 2: got')):
        table.write_bytes(content)
        assert main(words) == 2
        assert message in capsys.readouterr().err


def run(*words, **options):
    """Run a command in a process of its own."""
    return subprocess.run([sys.executable, '-m', 'starcal_ros.cli', *map(str, words)], text=True,
                          stderr=subprocess.PIPE, env={**os.environ, 'PYTHONPATH': str(TOP)},
                          **options)


def test_an_output_that_is_full_or_closed_is_said_in_one_line(tmp_path):
    path = write(tmp_path / 'run.mcap')
    with open('/dev/full', 'w') as full:
        done = run('info', path, stdout=full)
    assert (done.returncode, done.stderr) == (
        1, 'starcal info: error: standard output: No space left on device\n')


def test_an_error_that_no_file_is_named_in_is_not_one_of_the_output(monkeypatch, capsys):
    def refuse(options):
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
    monkeypatch.setattr('starcal_ros.cli.info.run', refuse)
    assert main(['info', 'run.mcap']) == 1
    assert capsys.readouterr().err == 'starcal info: error: Cannot allocate memory\n'


def test_a_name_that_is_not_UTF_8_is_shown_with_its_bytes(tmp_path):
    path = os.fsencode(write(tmp_path / 'run.mcap'))
    os.rename(path, path + b'\xff.mcap')
    done = run('info', os.fsdecode(path + b'\xff.mcap'), stdout=subprocess.PIPE)
    assert done.returncode == 0 and 'run.mcap\\udcff.mcap' in done.stdout


def test_a_configuration_in_the_recording_without_end_is_a_warning(capsys, tmp_path):
    with Writer(tmp_path / 'run.mcap') as writer:
        writer.attach('config.yaml', b'a: &a [*a]', 'application/yaml')
        writer.write_batches(imu_batch('/imu/data_raw', GYRO),
                             centroids_batch('/star_tracker/centroids', FRAMES))
    assert main(['calibrate', str(tmp_path / 'run.mcap'), '--config', str(CONFIG), '--out',
                 str(tmp_path / 'r')]) == 3
    assert 'ROS 2 takes no alias' in capsys.readouterr().err
    assert parameter_file.parse(parameter_file.dump(TAN2018), '') == TAN2018
