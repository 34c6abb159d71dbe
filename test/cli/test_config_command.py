# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal config``: files that it writes, what it finds in them, what it tells."""

import io
import json
import sys

import pytest

from instruments import CONFIG
from starcal_ros.cli import main
from starcal_ros.config import parameter_file, presets
from starcal_ros.config.scenario import parameters


@pytest.fixture
def config(capsys):
    """Return a function that runs the command and returns status and both outputs."""
    def run(*words):
        try:
            status = main(['config', *map(str, words)])
        except SystemExit as end:
            status = end.code or 0
        out, err = capsys.readouterr()
        assert 'Traceback' not in out + err
        return status, out, err
    return run


def test_new_writes_a_file_that_is_read_and_in_order(config, tmp_path):
    path = tmp_path / 'mine.yaml'
    status, out, err = config(
        'new', 'mems', '--set', 'camera.width=1280', '--set', 'gyro.rate_hz=400', '--set',
        'mounting.fixed_angles_deg=[0, 90.0, 0]', '--out', path)
    assert (status, out, err) == (0, '', '')
    expected = presets.scenario('mems').replace({
        'camera.width': 1280, 'gyro.rate_hz': 400.0,
        'mounting.fixed_angles_deg': (0.0, 90.0, 0.0)})
    assert parameter_file.load(path) == expected
    assert config('check', path)[:2] == (0, f'{path}: nothing wrong, nothing odd\n')
    status, _, err = config('new', 'mems', '--out', path)
    assert status == 2 and 'exists' in err and '--overwrite' in err


def test_new_as_json_holds_all_parameters(config):
    status, out, err = config('new', 'fog', '--set', 'camera.focal_length_mm=0.5', '--json')
    told = json.loads(out)
    assert (status, told['preset'], told['file']) == (0, 'fog', None)
    assert told['parameters']['camera.focal_length_mm'] == 0.5
    assert 100 < len(told['parameters']) and told['parameters'].keys() <= parameters().keys()
    assert len(told['odd']) == err.count('warning: ') > 0


@pytest.mark.parametrize('words, said', [
    (['fod'], "invalid choice: 'fod'"),
    ([], 'PRESET is needed'),
    (['fog', '--set', 'gyro.rate=1.0'], 'did you mean gyro.rate_hz?'),
    (['fog', '--set', 'gyro.rate_hz=fast'], 'needs a float'),
    (['fog', '--set', 'gyro.rate_hz'], 'gyro.rate_hz: got'),
    (['fog', '--set', 'gyro.rate_hz=0.1'], 'allowed is 1 to 10000 Hz')])
def test_new_refuses_what_can_not_be(config, words, said):
    status, out, err = config('new', *words)
    assert (status, out) == (2, '') and said in err


def test_new_warns_of_what_is_odd(config):
    status, out, err = config('new', 'fog', '--set', 'camera.focal_length_mm=0.5')
    assert status == 0 and 'focal_length_mm: 0.5' in out
    assert 'warning: camera.focal_length_mm: 0.5 mm' in err


def test_new_asks_in_a_terminal(config, monkeypatch):
    """For the class, then for what a data sheet says; a wrong answer is told, and asked again."""
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    answers = ['fog', '2048', '1e9', '1024', *[''] * 20]
    monkeypatch.setattr('builtins.input', lambda prompt='': answers.pop(0))
    screen = Terminal()
    monkeypatch.setattr(sys, 'stderr', screen)
    status, out, _ = config('new', '--set', 'gyro.rate_hz=50.0')
    made = parameter_file.parse(out, 'it')
    assert status == 0
    assert (made.camera.width, made.camera.height, made.gyro.rate_hz) == (2048, 1024, 50.0)
    assert made.camera.focal_length_mm == presets.scenario('fog').camera.focal_length_mm
    said = screen.getvalue()
    assert 'camera.height: got 1000000000.0 (float), needs a int' in said
    assert 'Width of the detector [px] ' in said
    assert 'Sampling rate' not in said              # it was stated


def test_check_tells_all_errors_at_once_and_what_is_odd(config, tmp_path):
    path = tmp_path / 'wrong.yaml'
    path.write_text(CONFIG.read_text().replace('width: 1024', 'width: 10')
                    .replace('rate_hz: 100.0', 'rate_hz: 100').replace('seed: 1', 'sed: 1'))
    status, out, _ = config('check', path)
    assert status == 2
    assert [line.partition(': got')[0] for line in out.splitlines()] == [
        'error: camera.width', 'error: gyro.rate_hz',
        'error: simulation.sed: unknown parameter; did you mean simulation.seed?']
    path.write_text(CONFIG.read_text().replace('arw_deg_sqrt_h: 0.001', 'arw_deg_sqrt_h: 0.3'))
    status, out, _ = config('check', path, '--json')
    told = json.loads(out)
    assert status == 4 and told['errors'] == [] and told['notices'] == []
    assert [text.partition(':')[0] for text in told['odd']] == [
        'estimator.initial_sigma.gyro_bias_deg_h']
    assert config('check', tmp_path / 'none.yaml')[0] == 2


def test_check_looks_at_the_sections_of_every_node(config, tmp_path):
    path = tmp_path / 'nodes.yaml'
    path.write_text('/**: {ros__parameters: {mounting: {fixed_angles_deg: [0.0, 0.0, 0.0]}}}\n'
                    '/estimator: {ros__parameters: {estimator: {feedback: 3}}}\n'
                    '/player: {ros__parameters: {player: {rate: -1.0}}}\n'
                    '/recordr: {ros__parameters: {recorder: {output: x.mcap}}}\n')
    status, out, _ = config('check', path)
    assert status == 2
    assert [line.partition(': got')[0] for line in out.splitlines()[:2]] == [
        'error: estimator.feedback', 'error: player.rate']
    path.write_text(path.read_text().replace('feedback: 3', 'feedback: true')
                    .replace('rate: -1.0', 'rate: 1.0'))
    status, out, _ = config('check', path)
    assert status == 0 and 'note: ' in out and 'did you mean recorder?' in out


def test_describe_tells_of_a_parameter_a_group_and_which_there_are(config):
    status, out, _ = config('describe', 'estimator.gate_probability')
    assert status == 0 and 'float' in out and '0.9999' in out and '0.5 to 1' in out
    assert 'ros2 param set' in out
    assert config('describe', 'gyro')[1].count('\n  type ') == 4
    assert 'estimator.tolerance' in config('describe')[1]
    for mistyped, near in (
            ('gyro.rat_hz', 'gyro.rate_hz'), ('camra', 'camera'),
            ('arw', 'gyro.arw_deg_sqrt_h or truth.gyro.arw_deg_sqrt_h'),
            ('estimator.gate', 'estimator.gate_probability')):
        status, _, err = config('describe', mistyped)
        assert status == 2 and err == (
            f'starcal config describe: error: {mistyped}: unknown parameter or group; did you '
            f'mean {near}?\n')
    assert '0 to 9007199254740992\n' in config('describe', 'simulation.seed')[1]
    told, = json.loads(config('describe', 'camera.width', '--json')[1])
    assert (told['default'], told['low'], told['high'], told['unit']) == (1024, 16, 65536, 'px')


def test_list_has_all_parameters_or_those_of_a_group(config):
    status, out, _ = config('list')
    assert status == 0 and all(key in out for key in parameters())
    assert len(json.loads(config('list', '--json')[1])) == len(parameters())
    assert {each['name'].rpartition('.')[0] for each in json.loads(
        config('list', 'estimator.augment', '--json')[1])} == {'estimator.augment'}


def test_schema_is_the_shipped_one(config):
    shipped = (CONFIG.parent / 'parameters.schema.json').read_text()
    assert config('schema') == (0, shipped, '')
