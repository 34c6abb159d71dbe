# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The command starcal: exit status, one line that names the culprit, never a traceback."""

import re
import subprocess
import sys

import pytest

from instruments import CONFIG, TAN2018, TOP
from refusals import assert_refused, altered
import starcal_ros
from starcal_ros.recording.writer import Writer, imu_batch
from starcal_ros.simulation import sensors


def test_help_of_every_command_says_what_it_does(starcal):
    choices = starcal('no-such-command').err
    names = re.findall(r'[a-z]+', choices.split('choose from')[1])
    assert {'demo', 'simulate', 'calibrate', 'play', 'info'} <= set(names)
    overview = starcal('--help').out
    for name in names:
        done = starcal(name, '--help')
        assert done.status == 0
        assert done.out.startswith(f'usage: starcal {name}')
        _, text, *_ = done.out.split('\n\n')
        assert re.match(r'[A-Z][^.]{20,}\.', text.replace('\n', ' ')), name     # a sentence
        assert not re.search(r'\b(\w+ \w+) \1\b', ' '.join(done.out.split())), name   # twice
        assert re.search(rf'^ +{name}\s+\w', overview, re.MULTILINE), name


@pytest.mark.parametrize('words, said', [
    (['calibarte'], "starcal: error: no command 'calibarte'; did you mean calibrate?"),
    (['xyzzy'], "'xyzzy'"),
    (['reproduce', 'tabel4'], "invalid choice: 'tabel4'; did you mean table4?"),
    (['reproduce', 'xyzzy'], "'xyzzy'"),
    (['montecarlo', '--sweep', 'star_traker.exposure_s=0.1,0.2'],
     'montecarlo: error: star_traker.exposure_s: unknown parameter; did you mean '
     'star_tracker.exposure_s?'),
    (['info', '--chek', 'run.mcap'], 'starcal info: error: unrecognized arguments: --chek')])
def test_what_is_mistyped_is_named_with_what_is_near(starcal, words, said):
    done = starcal(*words)
    assert done.status == 2 and said in done.err
    assert done.err.count('did you mean') == said.count('did you mean')


@pytest.mark.parametrize('line, offered', [
    ('starcal cal', ['calibrate ']), ('starcal calibrate --ado', ['--adopt ']),
    ('starcal config desc', ['describe ']),
    ('starcal config describe gyro.ar', ['gyro.arw_deg_sqrt_h ']),
    ('starcal config new m', ['mems ']), ('starcal info --che', ['--check '])])
def test_a_shell_completes(tmp_path, line, offered):
    """As the function that register-python-argcomplete gives a shell calls it."""
    pytest.importorskip('argcomplete')
    out = tmp_path / 'out'
    subprocess.run([sys.executable, '-m', 'starcal_ros.cli'], check=True, cwd=tmp_path, env={
        'PYTHONPATH': str(TOP), '_ARGCOMPLETE': '1', '_ARGCOMPLETE_STDOUT_FILENAME': str(out),
        'COMP_LINE': line, 'COMP_POINT': str(len(line)), '_ARGCOMPLETE_IFS': '\n'})
    assert out.read_text().split('\n') == offered


def test_no_command_is_an_error_that_shows_the_usage(starcal):
    done = starcal()
    assert done.status == 2 and done.err.startswith('usage: starcal')


def test_version_is_that_of_the_package(starcal):
    assert starcal('--version') == (0, f'starcal_ros {starcal_ros.__version__}\n', '')


def test_exit_status_reaches_the_shell(tmp_path):
    done = subprocess.run([sys.executable, '-m', 'starcal_ros.cli', 'info', 'missing.mcap'],
                          cwd=tmp_path, env={'PYTHONPATH': str(TOP)}, text=True,
                          capture_output=True)
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.startswith('starcal info: error: missing.mcap does not exist')
    assert done.stderr.count('\n') == 1


# Wrong configuration, of any command that takes one


@pytest.mark.parametrize('command', ['simulate', 'calibrate'])
@pytest.mark.parametrize('old, new, culprits', [
    ('focal_length_mm: 25.5', 'focal_lenght_mm: 25.5',
     ['camera.focal_lenght_mm', 'did you mean camera.focal_length_mm']),
    ('width: 1024', 'width: 1024.5', ['camera.width', '1024.5', 'int']),
    ('rate_hz: 100.0', 'rate_hz: fast', ['gyro.rate_hz', "'fast'", 'float']),
    ('rate_hz: 100.0', 'rate_hz: 100', ['gyro.rate_hz', 'write 100.0']),
    ('rate_hz: 100.0', 'rate_hz: -1.0', ['gyro.rate_hz', '-1.0', '1 to 10000 Hz']),
    ('velocity: geocentre', 'velocity: fast', ['observer.velocity', "'barycentre'"]),
    ('principal_point_px: [0.0, 0.0]', 'principal_point_px: [0.0]',
     ['camera.principal_point_px', 'needs 2']),
    ('/**:', '/**: [', ['not YAML']),
    ('ros__parameters', 'parameters', ['ros__parameters']),
], ids=['unknown key', 'float for int', 'string for float', 'int for float', 'out of range',
        'no such choice', 'too short', 'not YAML', 'not ROS'])
def test_wrong_parameter_is_named_with_what_is_allowed(starcal, bag, tmp_path, command, old, new,
                                                       culprits):
    path, out = altered(tmp_path, old, new), tmp_path / 'out'
    words = [bag] if command == 'calibrate' else []
    done = starcal(command, *words, '--config', path, '--out', out)
    assert_refused(done, command, path, *culprits)
    assert not out.exists()


@pytest.mark.parametrize('command', ['simulate', 'calibrate'])
def test_configuration_that_can_not_be_read_is_named(starcal, bag, tmp_path, command):
    words = [bag] if command == 'calibrate' else []
    for path in (tmp_path / 'missing.yaml', tmp_path, bag):     # absent, a folder, binary
        done = starcal(command, *words, '--config', path, '--out', tmp_path / 'out')
        assert_refused(done, command, path, 'cannot be read')


@pytest.mark.parametrize('option, value, key', [
    ('--duration', '-3', 'simulation.duration_s'), ('--duration', 'nan', 'simulation.duration_s'),
    ('--seed', '-1', 'simulation.seed')])
def test_impossible_value_on_the_command_line_is_named(starcal, tmp_path, option, value, key):
    done = starcal('simulate', '--out', tmp_path / 'out.mcap', f'{option}={value}')
    assert_refused(done, 'simulate', key, value)
    assert not (tmp_path / 'out.mcap').exists()


# Wrong recordings


def unreadable(folder):
    """Make what is not a recording; return each path with what must be said of it."""
    (folder / 'text.mcap').write_text('not a recording, but longer than the magic bytes\n' * 9)
    (folder / 'empty.mcap').touch()
    (folder / 'folder').mkdir()
    return {folder / 'missing.mcap': 'does not exist', folder / 'text.mcap': 'not an MCAP',
            folder / 'empty.mcap': 'not an MCAP', folder / 'folder': 'metadata.yaml'}


@pytest.mark.parametrize('command', ['info', 'calibrate'])
def test_path_that_is_no_recording_is_named_with_the_reason(starcal, tmp_path, command):
    for path, reason in unreadable(tmp_path).items():
        words = ['--out', tmp_path / 'result.json'] if command == 'calibrate' else []
        assert_refused(starcal(command, path, *words), command, path, reason)
    assert not (tmp_path / 'result.json').exists()


def test_recording_without_a_sensor_topic_is_named_with_the_topics_it_has(starcal, tmp_path):
    gyro = sensors.gyro(TAN2018).next(100)
    with Writer(tmp_path / 'gyro.mcap') as writer:
        writer.write_batches(imu_batch('/imu/data_raw', gyro))
    done = starcal('calibrate', tmp_path / 'gyro.mcap', '--config', CONFIG, '--out',
                   tmp_path / 'result.json')
    assert_refused(done, 'calibrate', tmp_path / 'gyro.mcap', '/star_tracker/centroids',
                   '/imu/data_raw')
    with Writer(tmp_path / 'none.mcap'):
        pass
    done = starcal('calibrate', tmp_path / 'none.mcap', '--config', CONFIG, '--out',
                   tmp_path / 'result.json')
    assert_refused(done, 'calibrate', tmp_path / 'none.mcap', '/imu/data_raw')


@pytest.mark.parametrize('old, new, key', [
    ('width: 1024', 'width: 2048', 'camera.width'),
    ('pixel_pitch_mm: 0.00645', 'pixel_pitch_mm: 0.0065', 'camera.pixel_pitch_mm'),
    ('rate_hz: 100.0', 'rate_hz: 50.0', 'gyro.rate_hz')])
def test_configuration_that_is_not_the_recordings_own_is_said(starcal, bag, tmp_path, old, new,
                                                              key):
    """The recording carries its own: a detector of 2048 px puts u0 at -507 px, at 0.4 px sigma."""
    path = altered(tmp_path, old, new)
    done = starcal('calibrate', bag, '--config', path, '--out', tmp_path / 'result.json')
    assert done.status in (0, 1, 2, 3)
    assert [line for line in done.err.splitlines() if key in line]


# Outputs


def test_existing_recording_is_not_overwritten_unless_told_so(starcal, tmp_path):
    path = tmp_path / 'run.mcap'
    path.write_text('precious')
    assert_refused(starcal('simulate', '--out', path, '--duration', '1'), 'simulate', path,
                   'exists')
    assert path.read_text() == 'precious'
    assert starcal('simulate', '--out', path, '--duration', '1', '--overwrite').status == 0
    assert '/imu/data_raw' in starcal('info', path).out


@pytest.mark.parametrize('place', ['nowhere/out', '.'])
@pytest.mark.parametrize('command', ['simulate', 'calibrate'])
def test_output_that_can_not_be_written_is_wrong_input(starcal, bag, tmp_path, command, place):
    """A folder that is absent, and a folder in place of a file."""
    words = [bag] if command == 'calibrate' else ['--duration', '1', '--overwrite']
    done = starcal(command, *words, '--out', tmp_path / place)
    assert_refused(done, command, tmp_path / place, 'cannot be written')
