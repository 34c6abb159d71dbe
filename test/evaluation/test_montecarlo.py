# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A study gives the same numbers however it is cut up, spread, or interrupted."""

from dataclasses import fields
import json
import os
import shutil
import signal

import numpy as np
import pytest

from instruments import CONFIG, TAN2018
import starcal_ros
from starcal_ros import cli
from starcal_ros.cli import cluster
from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError
from starcal_ros.evaluation import montecarlo, tasks
from starcal_ros.evaluation.batch_results import Runs, run_batch
from starcal_ros.evaluation.montecarlo import BATCH, MonteCarlo
from starcal_ros.filter.states import STATE_NAMES
from starcal_ros.reproduction import wrong_models

SCENARIO = TAN2018.replace({'simulation.duration_s': 20.0})
STUDY = MonteCarlo.of(SCENARIO, BATCH + 3, 'star_tracker.centroid_sigma_px=0.05,0.1')


def assert_same(runs, expected):
    for field in fields(Runs):
        if getattr(expected, field.name).dtype.kind == 'U':
            assert getattr(runs, field.name).tolist() == getattr(expected, field.name).tolist()
            continue
        np.testing.assert_allclose(getattr(runs, field.name), getattr(expected, field.name),
                                   rtol=1e-9, err_msg=field.name)


@pytest.fixture(scope='module')
def finished(tmp_path_factory):
    """Return the folder of a study that is done."""
    return tmp_path_factory.mktemp('study') / 'parts'


@pytest.fixture(scope='module')
def results(finished):
    return montecarlo.run(STUDY, finished, bounded=True)


def test_each_value_has_all_its_runs_in_order(results):
    assert [runs.seed.tolist() for runs in results] == [list(range(1, BATCH + 4))] * 2


def test_batches_and_processes_do_not_show_in_the_numbers(results):
    for value, runs in zip(STUDY.values, results):
        assert_same(runs, run_batch(STUDY.at(value), range(1, BATCH + 4)))


def test_swept_parameter_counts(results):
    """Twice the noise: the camera is known half as well, in T18's Table 4 and here."""
    fine, coarse = (runs.sigma[:, -1, 11].mean() for runs in results)
    assert coarse / fine == pytest.approx(2.0, rel=0.1)


def test_runs_are_judged_as_a_calibrator_judges_each():
    scenario = SCENARIO.replace({'simulation.duration_s': 90.0, 'motion.dwell_s': 5.0,
                                 'estimator.answer_changes': False,
                                 'truth.gyro.arw_deg_sqrt_h': 0.01})
    runs = run_batch(scenario, [1, 2, 3], judged=True)
    assert runs.verdict.tolist() == ['inconsistent'] * 3
    for seed, failed in zip(runs.seed.tolist(), runs.failed.tolist()):
        alone = wrong_models.run(wrong_models.WrongModel('walk x 10', {
            'truth.gyro.arw_deg_sqrt_h': 0.01}), scenario, seed)
        assert set(failed.split('; ')) == set(alone.failed)
        assert 'NIS of the turns' in failed
    summary = montecarlo.summarize(scenario, runs)
    assert summary['verdicts'] == {'inconsistent': 3}
    assert summary['failed_tests']['NIS of the turns'] == 3
    plain = run_batch(scenario, [1, 2, 3])
    np.testing.assert_array_equal(plain.error, runs.error)
    assert plain.verdict.tolist() == [''] * 3


def test_interrupted_study_goes_on_where_it_was(results, finished, tmp_path, monkeypatch):
    parts = tmp_path / 'parts'
    shutil.copytree(finished, parts)
    names = sorted(parts.iterdir())
    batches = [name for name in names if not name.stem.endswith('bound')]
    assert len(names) == len(batches) + 2
    left_out = int(batches[0].stem.split('_')[2]) - int(batches[0].stem.split('_')[1]) + 1
    batches[0].unlink()
    monkeypatch.setattr(tasks, 'workers', lambda: 1)
    (parts / 'cut_off.npz.part').write_bytes(b'half a file')
    before = {name: name.stat().st_mtime_ns for name in names if name.exists()}
    progress = []
    again = montecarlo.run(STUDY, parts, progress.append, bounded=True)
    assert progress == pytest.approx([1.0 - left_out / (2 * STUDY.runs), 1.0])
    assert all(name.stat().st_mtime_ns == when for name, when in before.items())
    for runs, expected in zip(again, results):
        assert_same(runs, expected)


def test_summary_and_file_hold_what_others_need(results, finished, tmp_path):
    out, parts = tmp_path / 'study.json', tmp_path / 'parts'
    shutil.copytree(finished, parts)
    montecarlo.finish(STUDY, results, out, parts)
    summary = json.loads(out.read_text())
    assert summary['sweep'] == 'star_tracker.centroid_sigma_px'
    point = summary['points'][1]
    assert point['star_tracker.centroid_sigma_px'] == 0.1 and point['runs'] == BATCH + 3
    assert set(point['states']) == set(STATE_NAMES)
    assert {'rms', 'bound', 'ratio'} <= set(point['states']['f'])
    assert {'nees_mean', 'nis_mean'} <= set(point)
    with np.load(tmp_path / 'study.npz') as arrays:
        assert arrays['seed'].tolist() == list(range(1, BATCH + 4)) * 2
        assert parameter_file.parse(str(arrays['config']), 'study') == SCENARIO
    assert not parts.exists()


def test_command_writes_a_summary(tmp_path, capsys):
    out = tmp_path / 'mc.json'
    status = cli.main(['montecarlo', '--config', str(CONFIG), '--runs', '3', '--duration', '5',
                       '--out', str(out)])
    assert status == 0
    assert json.loads(out.read_text())['runs'] == 3
    assert (tmp_path / 'mc.npz').is_file()
    assert sorted(tmp_path.iterdir()) == [out, tmp_path / 'mc.npz']
    assert 'NEES' in capsys.readouterr().out


def test_command_has_the_optional_states(tmp_path, capsys):
    config, out = tmp_path / 'mine.yaml', tmp_path / 'mc.json'
    config.write_text(parameter_file.dump(TAN2018.replace({
        'estimator.augment.gyro_matrix_sigma_ppm': 500.0,
        'estimator.augment.time_offset_sigma_s': 0.01})))
    assert cli.main(['montecarlo', '--config', str(config), '--runs', '3', '--duration', '5',
                     '--out', str(out)]) == 0
    states = json.loads(out.read_text())['states']
    assert states['M_zz_ppm']['unit'] == 'ppm' and states['tau_s']['bound'] <= 0.01
    with np.load(tmp_path / 'mc.npz') as arrays:
        assert arrays['error'].shape[2] == arrays['sigma'].shape[2] == 26
    shown = capsys.readouterr().out
    assert 'NEES' in shown and 'of 26 states' in shown and 'M_zz_ppm' in shown


@pytest.mark.parametrize('sweep, culprit', [
    ('star_tracker.centroid_sigma=1.0', 'did you mean star_tracker.centroid_sigma_px'),
    ('star_tracker.centroid_sigma_px=', 'got no values'),
    ('star_tracker.centroid_sigma_px=a,b', "got 'a,b', needs float"),
    ('star_tracker.centroid_sigma_px=-1.0', 'got -1.0, allowed is'),
    ('camera.distortion=0.0,0.1', 'needs a list'),
])
def test_wrong_sweep_is_named(sweep, culprit, capsys):
    with pytest.raises(ConfigError, match=culprit):
        MonteCarlo.of(SCENARIO, 3, sweep)
    assert cli.main(['montecarlo', '--sweep', sweep]) == 2
    assert culprit in capsys.readouterr().err


@pytest.mark.slow
def test_same_study_on_a_dask_cluster_gives_the_same_numbers(results, tmp_path):
    distributed = pytest.importorskip('distributed')
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None,
                                  host='127.0.0.1') as there:
        with cluster.spread(there.scheduler_address):
            spread = montecarlo.run(STUDY, tmp_path / 'parts')
    for runs, expected in zip(spread, results):
        assert_same(runs, expected)


def test_absent_cluster_is_named(capsys):
    pytest.importorskip('distributed')
    assert cli.main(['montecarlo', '--runs', '1', '--dask', 'nonsense://x']) == 2
    assert 'nonsense' in capsys.readouterr().err


@pytest.mark.parametrize('runs, workers, size', [
    (64, 1, 22), (64, 2, 16), (64, 4, 16), (64, 8, 8), (64, 16, 4), (100, 16, 7), (3, 16, 1),
    (10_000, 16, 25), (1, 1, 1)])
def test_batches_follow_from_runs_and_workers(runs, workers, size):
    assert montecarlo.batch_size(runs, workers) == size <= BATCH
    rounds = -(-(-(-runs // size)) // workers)
    assert rounds * size * workers < runs + workers * rounds      # none waits for more than a run


def test_a_study_goes_on_with_batches_of_another_size(results, tmp_path, monkeypatch):
    parts = tmp_path / 'parts'
    monkeypatch.setattr(tasks, 'workers', lambda: 5)
    whole = montecarlo.run(STUDY, parts)
    batches = sorted(parts.glob('*_[0-9]*_[0-9]*.npz'))
    assert len(batches) > 5
    batches[1].unlink()
    monkeypatch.setattr(tasks, 'workers', lambda: 1)
    for runs, again, expected in zip(whole, montecarlo.run(STUDY, parts), results):
        assert_same(runs, expected)
        assert_same(again, expected)


def test_the_loss_of_a_worker_is_said_and_its_work_done_again(tmp_path, capsys):
    parts, once = tmp_path / 'parts', tmp_path / 'killed'
    parts.mkdir()
    names = [parts / f'{k}.npz' for k in range(4)]
    tasks.complete(names, kills_itself, [(k, once) for k in range(4)])
    assert once.exists() and 'a worker was lost' in capsys.readouterr().err
    for k, name in enumerate(names):
        with np.load(name) as arrays:
            assert arrays['value'] == k


def test_workers_that_are_always_lost_end_the_study(tmp_path):
    with pytest.raises(ConfigError, match='3 times before a task was done'):
        tasks.complete([tmp_path / 'a.npz'], kills_itself, [(1, None)])


@pytest.mark.slow
def test_the_loss_of_a_worker_of_a_cluster_is_survived_and_that_of_all_is_named(
        tmp_path, monkeypatch, capsys):
    distributed = pytest.importorskip('distributed')
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None,
                                  host='127.0.0.1') as there:
        with cluster.spread(there.scheduler_address):
            found = dict(tasks.each(kills_itself, [(k, tmp_path / 'once') for k in range(4)]))
        assert {k: int(each['value']) for k, each in found.items()} == {k: k for k in range(4)}
        with pytest.raises(ConfigError, match='the Dask cluster: .* 4 different workers'):
            with cluster.spread(there.scheduler_address):
                dict(tasks.each(kills_itself, [(1, None)]))
        monkeypatch.setattr(cluster, 'version', kills_itself_at_once)
        assert cli.main(['montecarlo', '--runs', '1', '--dask', there.scheduler_address]) == 2
        assert 'the Dask cluster: ' in capsys.readouterr().err


@pytest.mark.slow
def test_a_cluster_without_workers_or_with_others_is_refused(monkeypatch, capsys):
    distributed = pytest.importorskip('distributed')
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None,
                                  host='127.0.0.1') as there:
        address = there.scheduler_address
        with monkeypatch.context() as here:
            here.setattr('starcal_ros.__version__', '9.9.9')
            assert cli.main(['montecarlo', '--runs', '1', '--dask', address]) == 2
        assert f'have starcal_ros {starcal_ros.__version__}, here is 9.9.9' in (
            capsys.readouterr().err)
    with distributed.LocalCluster(n_workers=0, dashboard_address=None, host='127.0.0.1') as there:
        monkeypatch.setattr(cluster, '_PATIENCE_S', 0.5)
        assert cli.main(['montecarlo', '--runs', '1', '--dask', there.scheduler_address]) == 2
        assert f'{there.scheduler_address} has no worker' in capsys.readouterr().err


def kills_itself(value, once):
    """Return a value; before that, once or always, end the process that was to do so."""
    if value == 1 and not (once and once.exists()):
        if once:
            once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {'value': np.array(value)}


def kills_itself_at_once():
    """End the process that calls it."""
    os.kill(os.getpid(), signal.SIGKILL)
