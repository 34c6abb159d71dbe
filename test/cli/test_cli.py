# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The command starcal: exit status, one line that names the culprit, never a traceback."""

import hashlib
import json
import re
import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest

from instruments import CONFIG, TAN2018, TOP
import starcal_ros
from starcal_ros.cli import COMMANDS, main
from starcal_ros.config import parameter_file
from starcal_ros.config.nodes import RecorderConfig
from starcal_ros.config.scenario import Scenario, from_flat
from starcal_ros.recording import reader
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch
from starcal_ros.results import initial
from starcal_ros.results.store import CalibrationStore
from starcal_ros.simulation import sensors

TOPICS = {'/imu/data_raw': ('sensor_msgs/msg/Imu', 2000),
          '/star_tracker/centroids': ('sensor_msgs/msg/PointCloud2', 40),
          '/star_tracker/camera_info': ('sensor_msgs/msg/CameraInfo', 1),
          '/truth/attitude': ('geometry_msgs/msg/QuaternionStamped', 40),
          '/truth/parameters': ('std_msgs/msg/Float64MultiArray', 1)}


class Done(NamedTuple):
    """What a command did."""

    status: int
    out: str
    err: str


@pytest.fixture
def starcal(capsys):
    """Return a function that runs the command; an exception that it lets out fails the test."""
    def run(*words):
        try:
            status = main([str(word) for word in words])
        except SystemExit as end:                   # argparse: usage, --help, --version
            status = end.code or 0
        out, err = capsys.readouterr()
        assert 'Traceback' not in out + err
        return Done(status, out, err)
    return run


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return a recording of 20 s that the command itself has made."""
    path = tmp_path_factory.mktemp('bag') / 'run.mcap'
    assert main(['simulate', '--out', str(path), '--duration', '20']) == 0
    return path


NOT_YET = 3             # after the 20 s of these recordings


def assert_refused(done, command, *culprits, status=2):
    """Check the exit status and the one line of complaint."""
    assert done.status == status, done.err
    lines = [line for line in done.err.splitlines()
             if line.startswith(f'starcal {command}: error: ')]
    assert len(lines) == 1
    assert done.err.rstrip().splitlines()[-1] == lines[0]
    for culprit in culprits:
        assert str(culprit) in lines[0]


def altered(folder, old, new):
    """Return a parameter file that differs from the shipped one in one place."""
    text = CONFIG.read_text()
    assert text.count(old) == 1
    path = folder / 'other.yaml'
    path.write_text(text.replace(old, new))
    return path


# Help


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


def test_recording_that_gives_no_calibration_is_told_with_the_counts(starcal, bag, tmp_path):
    """Exit status 1: nothing is wrong with the input, but a lens of 50 mm was never there."""
    path = altered(tmp_path, 'focal_length_mm: 25.5', 'focal_length_mm: 50.0')
    done = starcal('calibrate', bag, '--config', path, '--out', tmp_path / 'result.json')
    assert_refused(done, 'calibrate', 'no attitude', '2000 gyro readings', '40 frames', status=1)
    assert not (tmp_path / 'result.json').exists()


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


def test_figure_that_can_not_be_written_is_wrong_input(starcal, bag, tmp_path):
    done = starcal('calibrate', bag, '--out', tmp_path / 'result.json',
                   '--figure', tmp_path / 'nowhere' / 'figure.png')
    assert_refused(done, 'calibrate', tmp_path / 'nowhere' / 'figure.png')


# What goes right


def test_info_lists_the_topics_with_types_and_counts(starcal, bag):
    done = starcal('info', bag)
    assert (done.status, done.err) == (0, '')
    for topic, (type_name, count) in TOPICS.items():
        line, = [line for line in done.out.splitlines() if topic in line]
        assert type_name in line
        assert str(count) in re.findall(r'\d+', line.split(type_name)[1])
    assert 'config.yaml' in done.out and 'truth.json' in done.out
    assert str(bag) in done.out.replace('\n', '')


# They make or show something, or have parts.
QUIET = {'simulate', 'play', 'watch', 'serve', 'config'}


def test_every_command_that_reports_gives_json(starcal):
    for name in set(COMMANDS) - QUIET:
        assert '--json' in starcal(name, '--help').out, name


def test_info_as_json_is_all_that_it_tells(starcal, bag):
    done = starcal('info', bag, '--json', '--check')
    told = json.loads(done.out)
    assert (done.status, done.err, told['recording']) == (0, '', str(bag))
    assert {each['name']: (each['type'], each['messages'])
            for each in told['topics']} == TOPICS
    assert {each['read_as']: each['name'] for each in told['topics'] if each['read_as']} == {
        'gyro': '/imu/data_raw', 'frames': '/star_tracker/centroids'}
    gyro = next(each for each in told['topics'] if each['read_as'] == 'gyro')
    assert gyro['rate_hz'] == pytest.approx(100.0)
    assert gyro['last_ns'] - gyro['first_ns'] == 19_990_000_000
    assert set(told['attachments']) == {'config.yaml', 'truth.json'}
    assert told['warnings'] == told['stamps'] == []
    assert told['bytes'] == bag.stat().st_size
    found = told['check']['files'][bag.name]
    assert told['check']['sound'] and found['messages'] == 2082 and found['faults'] == []
    assert 'check' not in json.loads(starcal('info', bag, '--json').out)


def test_info_as_json_tells_what_is_damaged(starcal, bag, tmp_path):
    damaged, path = bytearray(bag.read_bytes()), tmp_path / 'damaged.mcap'
    damaged[len(damaged) // 2] ^= 1
    path.write_bytes(damaged)
    done = starcal('info', path, '--json', '--check')
    told = json.loads(done.out)
    assert done.status == 4 and not told['check']['sound']
    assert told['check']['files'][path.name]['faults']


@pytest.mark.parametrize('command', ['calibrate', 'intrinsics'])
def test_json_is_what_the_file_has_and_nothing_else_is_printed(starcal, bag, tmp_path, command):
    out = tmp_path / 'out.json'
    done = starcal(command, bag, '--out', out, '--json')
    assert done.status in (0, NOT_YET)
    assert json.loads(done.out) == json.loads(out.read_text())


def test_seed_makes_the_noise_and_nothing_else_does(starcal, tmp_path):
    """The same seed gives the same messages to the bit, another one others."""
    runs = []
    for k, seed in enumerate((7, 7, 8)):
        path = tmp_path / f'{k}.mcap'
        assert starcal('simulate', '--out', path, '--duration', '2', '--seed', seed).status == 0
        runs.append(reader.read(path))
    first, again, other = runs
    np.testing.assert_array_equal(first.gyro.rate, again.gyro.rate)
    np.testing.assert_array_equal(first.frames.uv_raster, again.frames.uv_raster)
    assert (first.gyro.rate != other.gyro.rate).all()
    assert first.frames.stamp_ns.tolist() == other.frames.stamp_ns.tolist()


def test_simulated_recording_carries_the_scenario_that_was_run(bag):
    attached = reader.read(bag).attachments['config.yaml'].decode()
    carried = parameter_file.parse(attached, 'bag')
    assert carried == TAN2018.replace({'simulation.duration_s': 20.0})


def test_calibrate_writes_the_result_and_says_where_it_came_from(starcal, bag, tmp_path):
    path = tmp_path / 'result.json'
    done = starcal('calibrate', bag, '--config', CONFIG, '--out', path)
    assert done.status == NOT_YET
    outcome = json.loads(path.read_text())
    assert np.shape(outcome['covariance']) == (16, 16)
    provenance = outcome['provenance']
    assert provenance['version'] == starcal_ros.__version__
    assert provenance['bag_sha256'] == hashlib.sha256(bag.read_bytes()).hexdigest()
    assert provenance['config_sha256'] == TAN2018.sha256
    # to be read by a person: what was estimated
    for name in ('u0', 'v0', 'f', 'k1', 'k2', 'p1', 'p2'):
        assert re.search(rf'\b{name}\b', done.out)
    assert 'not converged' in done.out and outcome['converged'] is False        # after 20 s
    assert '40 frames' in done.out and '2000 gyro readings' in done.out


def test_data_that_contradict_the_model_are_told_with_their_sigmas_scaled(starcal, tmp_path):
    """Stars of three times the stated noise: variance 9, sigmas of the camera times 3."""
    bag, out = tmp_path / 'noisy.mcap', tmp_path / 'r.json'
    noisy = altered(tmp_path, '    truth:  ', '    truth.star_tracker.centroid_sigma_px: 0.15\n'
                    '    truth:  ')
    assert starcal('simulate', '--config', noisy, '--out', bag, '--duration', 60).status == 0
    done = starcal('calibrate', bag, '--config', noisy, '--out', out)
    outcome = json.loads(out.read_text())
    assert done.status == 4 and outcome['verdict'] == 'inconsistent'
    assert 'the sigmas are not to be believed' in done.out and 'scaled sigma' in done.out
    failing = [each['name'] for each in outcome['consistency'] if not each['passed']]
    verdict = done.out[done.out.index('Verdict: inconsistent: '):]
    assert len(failing) > 1 and all(name in verdict for name in failing)
    assert outcome['advice'] == 'do not believe the sigmas: find what contradicts the model'


def test_what_explains_late_stamps_is_said_and_adopted_where_asked_for(starcal, tmp_path):
    bag, out, page = (tmp_path / name for name in ('late.mcap', 'r.json', 'r.html'))
    late = altered(tmp_path, '    truth:  ', '    truth.star_tracker.time_offset_s: 0.005\n'
                   '    truth:  ')
    assert starcal('simulate', '--config', late, '--out', bag, '--duration', 120).status == 0
    done = starcal('calibrate', bag, '--config', late, '--out', out, '--report', page, '--adopt')
    outcome = json.loads(out.read_text())
    found, line = outcome['explanations'], outcome['provenance']['adopted']
    assert found['to_adopt'] == found['tried'][0]['name'] == 'time offset of the star tracker'
    assert found['tried'][0]['lines'] == [line] and 'time_offset_sigma_s: ' in line
    assert found['tried'][0]['score'] > found['tried'][1]['score'] + 12.0
    assert done.status == NOT_YET and outcome['verdict'] == 'not yet'
    assert outcome['augmented']['names'] == ['tau_s']
    # A frame that is stamped late shows the sky of before its stamp.
    (tau_s,), (sigma_s,) = (outcome['augmented'][key] for key in ('estimates', 'sigmas'))
    assert abs(tau_s + 0.005) < 4.5 * sigma_s
    assert f'Adopted: {line}' in done.out and f'Adopted: {line}' in page.read_text()


def test_calibrate_exports_and_begins_with_what_was_saved(starcal, bag, tmp_path):
    """The second run starts where the first ended, as the node would."""
    scenario = TAN2018.replace({'estimator.calibration_directory': str(tmp_path / 'saved'),
                                'estimator.load_calibration': True})
    config = tmp_path / 'config.yaml'
    config.write_text(parameter_file.dump(scenario))
    words = ['calibrate', bag, '--config', config, '--out', tmp_path / 'result.json']
    first = starcal(*words, '--export', tmp_path / 'export')
    assert first.status == NOT_YET and 'has no calibration' in first.err
    assert sorted(path.name for path in (tmp_path / 'export').iterdir()) == [
        'camchain.yaml', 'camera_info.yaml', 'cameras.txt', 'imu.yaml', 'opencv.yaml']
    outcome = json.loads((tmp_path / 'result.json').read_text())
    folder = CalibrationStore(tmp_path / 'saved').save(initial.files(outcome, scenario))
    second = starcal(*words, '--overwrite')
    assert second.status == NOT_YET and f'calibration {folder}' in ' '.join(second.err.split())
    better = json.loads((tmp_path / 'result.json').read_text())
    assert better['provenance']['began_with'] == str(folder)
    assert (np.diagonal(better['covariance'])[9:] < np.diagonal(outcome['covariance'])[9:]).all()


def test_json_is_what_the_file_holds_and_nothing_else(starcal, bag, tmp_path):
    out = tmp_path / 'result.json'
    for words in (['calibrate', bag], ['intrinsics', bag],
                  ['montecarlo', '--runs', '1', '--duration', '20']):
        done = starcal(*words, '--out', out, '--overwrite', '--json')
        assert done.status in (0, NOT_YET, 4), done.err
        assert json.loads(done.out) == json.loads(out.read_text())


def test_export_to_a_file_is_wrong_input(starcal, bag, tmp_path):
    done = starcal('calibrate', bag, '--out', tmp_path / 'result.json', '--export', bag)
    assert_refused(done, 'calibrate', bag, 'cannot be made')


def test_play_hands_its_options_to_the_player(starcal, bag, monkeypatch):
    commands = []
    monkeypatch.setattr(subprocess, 'call', lambda command: commands.append(command) or 0)
    assert starcal('play', bag, '--rate', '3', '--start-offset', '2.5', '--loop').status == 0
    given = dict(word.split(':=') for word in commands[0] if ':=' in word)
    assert given == {'player.bag': str(bag), 'player.rate': '3.0',
                     'player.start_offset_s': '2.5', 'player.loop': 'true'}


def test_allan_finds_the_noise_that_was_simulated(starcal, tmp_path):
    """Two hours at rest: angle random walk 0.02, bias walk 0.5; table, file, JSON and figure."""
    pytest.importorskip('allantools')
    bag, out, figure = tmp_path / 'rest.mcap', tmp_path / 'noise.json', tmp_path / 'noise.png'
    gyro = sensors.gyro(TAN2018.replace({
        'motion.dwell_s': 1e5, 'gyro.rate_hz': 20.0, 'gyro.arw_deg_sqrt_h': 0.02,
        'truth.gyro.bias_random_walk_deg_h_sqrt_h': 0.5})).next(144_000)
    with Writer(bag) as writer:
        writer.write_batches(imu_batch('/gyro', gyro))
    done = starcal('allan', bag, '--out', out, '--figure', figure)
    assert done.status == 0 and 'warning: /gyro is taken for /imu/data_raw' in done.err
    found = json.loads(out.read_text())
    for axis in 'xyz':
        known = found['axes'][axis]['coefficients']
        assert known['angle_random_walk']['low'] < 0.02 < known['angle_random_walk']['high']
        assert known['rate_random_walk']['low'] < 0.5 < known['rate_random_walk']['high']
        assert known['quantisation']['value'] is None
    assert found['rate_hz'] == pytest.approx(20.0) and found['readings'] == 144_000
    assert 'not known, <' in done.out and figure.read_bytes().startswith(b'\x89PNG')
    scenario = parameter_file.parse(done.out[done.out.index('/**:'):], 'its lines')
    assert scenario.gyro.arw_deg_sqrt_h == pytest.approx(0.02, rel=0.02)
    assert scenario.estimator.process_noise.gyro_bias_deg_h_sqrt_h == pytest.approx(0.5, rel=0.5)
    done = starcal('allan', bag, '--gyro-topic', '/gyro', '--json')
    assert json.loads(done.out)['axes'] == found['axes'] and 'warning' not in done.err


def test_allan_says_what_is_used_and_what_is_wrong(starcal, bag, two_gyros, tmp_path,
                                                   monkeypatch):
    """The 20 s of rest before the first rotation of T18; two gyros; and no rest at all."""
    pytest.importorskip('allantools')
    done = starcal('allan', bag)
    assert done.status == 0 and 'gyro_bias_deg_h_sqrt_h: not known, below' in done.out
    assert_refused(starcal('allan', two_gyros), 'allan', '/d435/gyro (sensor_msgs', '--gyro-topic')
    with monkeypatch.context() as without:
        without.setitem(sys.modules, 'allantools', None)
        assert_refused(starcal('allan', bag), 'allan', "pip install 'starcal_ros[allan]'")
    turning = sensors.gyro(TAN2018.replace({'motion.dwell_s': 0.0})).next(2000)
    with Writer(tmp_path / 'turning.mcap') as writer:
        writer.write_batches(imu_batch('/imu/data_raw', turning[::100]))
    assert_refused(starcal('allan', tmp_path / 'turning.mcap'), 'allan', 'too few', status=1)


@pytest.fixture(scope='module')
def two_gyros(bag, tmp_path_factory):
    """Return the same recording with an accelerometer beside the gyro."""
    path = tmp_path_factory.mktemp('two') / 'two.mcap'
    recording = reader.read(bag)
    with Writer(path) as writer:
        writer.attach('config.yaml', recording.attachments['config.yaml'], 'application/yaml')
        writer.write_batches(imu_batch('/d435/gyro', recording.gyro),
                             imu_batch('/d435/accel', recording.gyro[::2]),
                             centroids_batch('/star_tracker/centroids', recording.frames))
    return path


@pytest.mark.parametrize('words', [['calibrate', '--out', 'r.json'], ['intrinsics'],
                                   ['bootstrap']], ids=lambda words: words[0])
def test_a_choice_that_is_needed_is_asked_for(starcal, two_gyros, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    done = starcal(words[0], two_gyros, *words[1:])
    assert_refused(done, words[0], '/d435/gyro (sensor_msgs/msg/Imu, 2000 messages, 100.00 Hz)',
                   '/d435/accel (sensor_msgs/msg/Imu, 1000 messages, 50.0', '--gyro-topic')
    assert_refused(starcal(words[0], two_gyros, *words[1:], '--gyro-topic', '/gyro'), words[0],
                   'no topic /gyro', '/d435/gyro (sensor')


def test_the_chosen_gyro_is_calibrated(starcal, bag, two_gyros, tmp_path):
    results = []
    for path, words in ((bag, []), (two_gyros, ['--gyro-topic', '/d435/gyro'])):
        assert starcal('calibrate', path, *words, '--out', tmp_path / 'r.json',
                       '--overwrite').status == NOT_YET
        results.append(json.loads((tmp_path / 'r.json').read_text()))
    assert results[0]['covariance'] == results[1]['covariance']


def test_info_says_what_is_read_as_what(starcal, bag, two_gyros):
    lines = starcal('info', bag).out.splitlines()
    assert [line.split()[-2] for line in lines if '/imu/data_raw' in line] == ['gyro']
    assert [line.split()[-2] for line in lines if '/centroids' in line] == ['frames']
    assert '2 topics may be the gyro: --gyro-topic chooses' in starcal('info', two_gyros).out
    done = starcal('info', two_gyros, '--gyro-topic', '/d435/gyro')
    assert 'may be' not in done.out and done.status == 0
    assert [line.split()[-2] for line in done.out.splitlines() if '/d435/gyro' in line] == ['gyro']


def test_play_leaves_out_the_gyro_that_was_not_chosen(starcal, two_gyros, monkeypatch):
    commands = []
    monkeypatch.setattr(subprocess, 'call', lambda command: commands.append(command) or 0)
    assert starcal('play', two_gyros, '--gyro-topic', '/d435/gyro').status == 0
    assert "player.topics:=['/d435/gyro', '/star_tracker/centroids']" in commands[0]
    assert_refused(starcal('play', two_gyros, '--gyro-topic', '/gyro'), 'play', 'no topic /gyro')


def test_the_configuration_of_a_recording_is_used_and_said(starcal, bag, tmp_path):
    own = tmp_path / 'own.yaml'
    own.write_bytes(reader.read(bag).attachments['config.yaml'])
    for name, words in (('with', ['--config', own]), ('without', [])):
        done = starcal('calibrate', bag, *words, '--out', tmp_path / name)
        assert done.status == NOT_YET
        said = f'configuration: config.yaml in {bag}\n'
        assert done.err.count(said) == (0 if words else 1)
    assert (tmp_path / 'with').read_bytes() == (tmp_path / 'without').read_bytes()


@pytest.mark.parametrize('words', [['calibrate', '--out', 'r.json'], ['intrinsics'],
                                   ['bootstrap']], ids=lambda words: words[0])
def test_no_configuration_is_guessed(starcal, bag, tmp_path, words):
    """Neither of a recording without one, nor with one that nobody wrote, or can read."""
    recording = reader.read(bag)
    for attached, said in ((None, 'carries no configuration'),
                           (parameter_file.dump(Scenario(recorder=RecorderConfig('x.mcap'))),
                            'states neither camera nor mounting'),
                           ('camera: 1', 'not a ROS 2 parameter file')):
        path = tmp_path / 'bare.mcap'
        with Writer(path, overwrite=True) as writer:
            if attached:
                writer.attach('config.yaml', attached.encode(), 'application/yaml')
            writer.write_batches(imu_batch('/imu/data_raw', recording.gyro))
            writer.write_batches(centroids_batch('/star_tracker/centroids', recording.frames))
        done = starcal(words[0], path, *words[1:])
        assert_refused(done, words[0], path, said, '--config FILE')


@pytest.mark.parametrize('command', ['simulate', 'calibrate'])
def test_a_mounting_that_is_left_out_is_said(starcal, bag, tmp_path, command):
    values = {key: value for key, value in TAN2018.flat().items()
              if key != 'mounting.quaternion_xyzw'}
    config = tmp_path / 'config.yaml'
    config.write_text(parameter_file.dump(from_flat(values)))
    words = [bag] if command == 'calibrate' else ['--duration', '1']
    done = starcal(command, *words, '--config', config, '--out', tmp_path / 'out')
    line, = [line for line in done.err.splitlines() if 'leaves out the mounting' in line]
    assert line.startswith(f'warning: {config} leaves out the mounting')
    done = starcal(command, *words, '--config', CONFIG, '--out', tmp_path / 'again')
    assert 'mounting' not in done.err


def test_each_command_reads_the_sections_of_its_node(starcal, tmp_path):
    """The simulators do not see the estimator's, and agree among themselves or are refused."""
    config, out = tmp_path / 'config.yaml', tmp_path / 'out.mcap'
    words = ['simulate', '--config', config, '--out', out, '--duration', '1', '--overwrite']
    config.write_text('/estimator: {ros__parameters: {nonsense: 1}}\n'
                      '/ns/gyro_sim: {ros__parameters: {gyro: {rate_hz: 50.0}}}\n')
    done = starcal(*words)
    assert done.status == 0
    assert f'{config} is read for /ns/star_tracker_sim and /ns/gyro_sim' in done.err
    assert len(reader.read(out).gyro) == 50
    config.write_text('/**: {ros__parameters: {gyro: {rate_hz: 50.0}}}\n'
                      '/gyro_sim: {ros__parameters: {gyro: {rate_hz: 20.0}}}\n')
    assert_refused(starcal(*words), 'simulate', 'gyro.rate_hz: is 50.0 for /star_tracker_sim and '
                   '20.0 for /gyro_sim')


def test_calibrate_draws_its_figure(starcal, bag, tmp_path):
    path = tmp_path / 'figure.png'
    done = starcal('calibrate', bag, '--out', tmp_path / 'r.json', '--figure', path)
    assert done.status == NOT_YET
    assert path.read_bytes().startswith(b'\x89PNG\r\n\x1a\n')


def test_gap_in_a_recording_is_a_warning_and_not_the_end(starcal, tmp_path):
    gyro, frames = sensors.gyro(TAN2018).next(1000), sensors.star_tracker(TAN2018).next(20)
    with Writer(tmp_path / 'gap.mcap') as writer:
        for part in (gyro[:400], gyro[600:]):
            writer.write_batches(imu_batch('/imu/data_raw', part))
        writer.write_batches(centroids_batch('/star_tracker/centroids', frames))
    done = starcal('calibrate', tmp_path / 'gap.mcap', '--config', CONFIG, '--out',
                   tmp_path / 'r.json')
    assert done.status == NOT_YET
    line, = [line for line in done.err.splitlines() if line.startswith('warning: ')]
    assert 'silent for 2.010 s' in line
    assert json.loads((tmp_path / 'r.json').read_text())['counts']['gyro_gaps'] == 1


def test_states_are_called_the_same_in_table_and_verdict(starcal, bag, tmp_path):
    done = starcal('calibrate', bag, '--out', tmp_path / 'r.json')
    said = done.out.partition('Verdict: ')[2]
    assert 'ε_x, ' in done.out and 'not yet: ε_x, ' in said and 'epsilon' not in done.out
