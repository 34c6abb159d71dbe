# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The chain from a focal length that is a tenth wrong and unidentified stars to the 16 states."""

import json

import joblib
import numpy as np
import pytest
from scipy.stats import chi2

from instruments import TAN2018
from starcal_ros.cli import bootstrap as command, main
from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError
from starcal_ros.evaluation import tasks
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.results.document import CalibrationError
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth
from starcal_ros.simulation.write_recording import simulate
from starcal_ros.workflows.bootstrap import bootstrap

pytest.importorskip('tetra3rs')

SCENARIO = TAN2018.replace({'simulation.duration_s': 480.0, 'camera.focal_length_mm': 23.5})
TRUTH = Truth.from_scenario(SCENARIO)
LIMIT = chi2.ppf(0.9999, 7)


@pytest.fixture(scope='module')
def sensed():
    """Return the readings and frames of eight minutes."""
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    return gyro.next(gyro.count), tracker.next(tracker.count)


@pytest.fixture(scope='module')
def chain(sensed):
    """Return what came of them."""
    return bootstrap(*sensed, SCENARIO)


def test_each_step_says_the_truth_and_more_than_the_last(chain):
    names = [step.name for step in chain.steps]
    assert names == ['nominal', 'self-calibration', 'bundle of the spots', 'angular distances',
                     '16 states']
    for step in chain.steps[1:]:
        error = step.camera.intrinsics - TRUTH.intrinsics
        assert error @ np.linalg.solve(step.camera.covariance, error) < LIMIT, step.name
    sigma = [step.camera.sigma[2] for step in chain.steps]
    assert sigma[1] < sigma[0] and sigma[2] < 0.02 * sigma[0]
    assert sigma[3] < 0.02 * sigma[2] and sigma[4] < sigma[3]


def test_the_stars_are_identified_and_none_wrongly(chain, sensed):
    _, frames = sensed
    true = frames[len(frames) // 4:].catalog_id
    found = chain.frames.catalog_id
    assert (found[found > 0] == true[found > 0]).all()
    assert (found > 0).mean() > 0.98


def test_filter_sees_only_frames_that_nothing_else_has_learnt_from(chain, sensed):
    n = len(sensed[1])
    assert chain.calibrator.counts.frames == n - n // 2
    assert chain.steps[3].camera.frames <= n // 2 - n // 4


def test_too_little_is_named(sensed):
    gyro, frames = sensed
    with pytest.raises(CalibrationError, match='self-calibration: no camera from 2 frames'):
        bootstrap(gyro, frames[:8], SCENARIO)
    with pytest.raises(CalibrationError, match='no camera from 0 frames'):
        bootstrap(GyroSamples.empty(), Frames.empty(), SCENARIO)


@pytest.mark.slow
def test_command_shows_the_camera_after_each_step(tmp_path, capsys):
    bag, out, config = tmp_path / 'run.mcap', tmp_path / 'result.json', tmp_path / 'off.yaml'
    simulate(SCENARIO.replace({'simulation.duration_s': 360.0}), bag)
    config.write_text(parameter_file.dump(SCENARIO))
    assert main(['bootstrap', str(bag), '--config', str(config), '--out', str(out)]) == 3
    result = json.loads(out.read_text())
    assert [step['step'] for step in result['steps']][-1] == '16 states'
    assert abs(result['intrinsics']['f_mm'] - TRUTH.intrinsics[2]) < 1e-3
    said = capsys.readouterr().out
    assert 'error ± sigma after each step' in said and 'spots identified' in said


@pytest.fixture(scope='module')
def three(tmp_path_factory):
    """Return two recordings of one name and one that ends after a few frames."""
    folder = tmp_path_factory.mktemp('three')
    bags = []
    for name, duration_s, seed in (('a/run', 240.0, 1), ('b/run', 240.0, 2), ('short', 4.0, 3)):
        bags.append(folder / f'{name}.mcap')
        bags[-1].parent.mkdir(exist_ok=True)
        simulate(SCENARIO.replace({'simulation.duration_s': duration_s, 'simulation.seed': seed}),
                 bags[-1])
    return [str(bag) for bag in bags]


@pytest.fixture(scope='module')
def alone(three, tmp_path_factory):
    """Return what comes of the first of them by itself."""
    out = tmp_path_factory.mktemp('alone') / 'result.json'
    assert main(['bootstrap', three[0], '--out', str(out)]) == 3
    return json.loads(out.read_text())


@pytest.mark.slow
def test_several_recordings_have_each_its_own_result(three, alone, tmp_path, capsys):
    out = tmp_path / 'results'
    assert main(['bootstrap', *three, '--out', str(out), '--json']) == 1
    assert sorted(path.name for path in out.iterdir()) == ['a_run.json', 'b_run.json']
    first, second, short = json.loads(capsys.readouterr().out)
    assert [each['recording'] for each in (first, second, short)] == three
    assert short == {'recording': three[2], 'error': short['error']}
    assert 'self-calibration: no camera from 2 frames' in short['error']
    assert json.loads((out / 'a_run.json').read_text()) == alone
    assert first == {'recording': three[0], **alone}
    assert second['intrinsics'] != alone['intrinsics']


@pytest.mark.slow
def test_recordings_on_a_cluster_give_the_same(three, alone, tmp_path, capsys):
    distributed = pytest.importorskip('distributed')
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None,
                                  host='127.0.0.1') as cluster:
        address = cluster.scheduler_address
        assert main(['bootstrap', three[0], three[2], '--out', str(tmp_path),
                     '--dask', address]) == 1
        assert main(['bootstrap', three[0], '--out', str(tmp_path / 'one.json'),
                     '--dask', address]) == 3
    said = capsys.readouterr()
    assert f'starcal bootstrap: error: {three[2]}: self-calibration: no camera' in said.err
    assert f'Bootstrap of {three[0]}' in said.out
    for name in ('run.json', 'one.json'):
        assert json.loads((tmp_path / name).read_text()) == alone


def test_what_is_done_is_shown_when_workers_are_lost(three, tmp_path, monkeypatch, capsys):
    found = command._Failed(4, 'as found')

    def lost(task, arguments):
        yield 1, found
        raise ConfigError('a worker was lost 3 times')
    monkeypatch.setattr(tasks, 'each', lost)
    assert main(['bootstrap', *three, '--out', str(tmp_path)]) == 2
    lines = capsys.readouterr().err.splitlines()[-3:]
    assert lines == [f'starcal bootstrap: error: {bag}: {text}' for bag, text in zip(three, (
        'a worker was lost 3 times', 'as found', 'a worker was lost 3 times'))]


def test_the_worst_of_several_is_the_status(three, monkeypatch):
    errors = [ValueError('no'), OSError('no'), ValueError('no'),
              ValueError('no'), ConfigError('no'), OSError('no')]

    def fail(*given):
        raise errors.pop(0)
    monkeypatch.setattr(command, '_calibrated', fail)
    with joblib.parallel_config(backend='sequential'):
        assert [main(['bootstrap', *three]), main(['bootstrap', *three])] == [1, 2]


def test_a_defect_met_with_one_of_several_ends_none_of_the_others(three, monkeypatch, capsys):
    errors = [KeyError('never thought of'), ValueError('no'), ValueError('no')]

    def fail(*given):
        raise errors.pop(0)
    monkeypatch.setattr(command, '_calibrated', fail)
    with joblib.parallel_config(backend='sequential'):
        assert main(['bootstrap', *three]) == 1
    said = capsys.readouterr().err
    assert f'error: {three[0]}: Traceback' in said and "KeyError: 'never thought of'" in said
    assert said.endswith(f'error: {three[1]}: no\nstarcal bootstrap: error: {three[2]}: no\n')


@pytest.mark.parametrize('bags, names', [
    (['a.mcap', 'b.mcap', 'c'], ['a', 'b', 'c']),
    (['1/run.mcap', '2/run.mcap'], ['1_run', '2_run']),
    (['x/1/run.mcap', 'x/run.mcap', 'x/other'], ['1_run', 'run', 'other'])])
def test_files_are_called_as_the_recordings(tmp_path, bags, names):
    folder = tmp_path / 'new'
    assert command._files(bags, folder) == [folder / f'{name}.json' for name in names]
    assert folder.is_dir()


def test_a_recording_that_is_given_twice_is_refused(three, tmp_path, capsys):
    assert main(['bootstrap', three[0], three[0], '--out', str(tmp_path)]) == 2
    assert 'run.json: is to be written twice' in capsys.readouterr().err
    assert main(['bootstrap', three[0], 'absent.mcap', '--out', str(tmp_path)]) == 2
    assert 'absent.mcap' in capsys.readouterr().err
    kept = tmp_path / 'kept'
    kept.write_text('precious')
    assert main(['bootstrap', *three, '--out', str(kept)]) == 2
    assert 'kept: cannot be made' in capsys.readouterr().err
    assert kept.read_text() == 'precious' and not list(tmp_path.glob('*.json'))


def test_an_extra_that_is_absent_is_named_for_one_and_for_several(three, monkeypatch, capsys):
    def absent(*given, **named):
        raise ImportError("needs pip install 'starcal_ros[identify]'")
    monkeypatch.setattr('starcal_ros.recording.measured_images.ImageMeter', absent)
    with joblib.parallel_config(backend='sequential'):
        for bags in (three[:1], three):
            assert main(['bootstrap', *bags]) == 2
            assert 'error: ' in (line := capsys.readouterr().err.splitlines()[-1])
            assert line.endswith("needs pip install 'starcal_ros[identify]'")
