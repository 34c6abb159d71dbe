# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a command reads: topics that are chosen, gyros at rest, configurations."""

import json
import os
import subprocess
import sys

import pytest

from instruments import CONFIG, TAN2018
from refusals import NOT_YET, assert_refused
from starcal_ros.config import parameter_file
from starcal_ros.config.nodes import RecorderConfig
from starcal_ros.config.scenario import Scenario, from_flat
from starcal_ros.recording import reader
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch
from starcal_ros.simulation import sensors


def test_play_hands_its_options_to_the_player(starcal, bag, monkeypatch):
    commands = []
    monkeypatch.setattr(subprocess, 'call', lambda command: commands.append(command) or 0)
    assert starcal('play', bag, '--rate', '3', '--start-offset', '2.5', '--loop').status == 0
    given = dict(word.split(':=') for word in commands[0] if ':=' in word)
    assert given == {'player.bag': str(bag), 'player.rate': '3.0',
                     'player.start_offset_s': '2.5', 'player.loop': 'true'}


@pytest.mark.parametrize('command', ['watch', 'serve'])
@pytest.mark.parametrize('given', ['left', '/left/'])
def test_the_estimator_of_a_namespace_is_looked_at(starcal, monkeypatch, command, given):
    pytest.importorskip('rclpy')
    commands = []

    def execv(_, words):
        commands.append(words)
        raise SystemExit                # it does not return
    monkeypatch.setattr(os, 'execv', execv)
    starcal(command, '--namespace', given)
    assert commands[0][-2:] == ['-r', '__ns:=/left']


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
