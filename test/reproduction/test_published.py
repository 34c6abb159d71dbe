# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Each table and figure can be reproduced, and says the numbers of the paper beside ours."""

import dataclasses
import io
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from instruments import CONFIG, REAL_SKY, TAN2018
from starcal_ros import cli, report
from starcal_ros.core.units import ARCSEC
from starcal_ros.evaluation import bounds, montecarlo
from starcal_ros.evaluation.batch_results import run_batch
from starcal_ros.evaluation.estimation_error import nominal
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import CALIBRATED, PSI, STATE_NAMES, UNIT
from starcal_ros.reproduction import published, real_images, sky_cases, traces
from starcal_ros.reproduction.published import open_loop, table4, user_mistakes
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky.refraction import Site
from starcal_ros.workflows.still_images.pipeline import Conditions

SCENARIO = TAN2018.replace({'simulation.duration_s': 6.0})


@pytest.fixture(autouse=True, scope='module')
def real_sky():
    """Say where the star images of others are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(real_images.VARIABLE, str(REAL_SKY))
        yield


@pytest.fixture(scope='module', params=published.names())
def outcome(request, tmp_path_factory):
    """Return what a table gives in a run that is far too short."""
    if request.param in ('real-sky', 'half-real') and not REAL_SKY.is_dir():
        pytest.skip(f'{REAL_SKY} is not there')
    with pytest.MonkeyPatch.context() as patch:
        if request.param == 'real-sky':     # the others are those of test_any_sky.py
            cases = [folder for folder in sky_cases.folders()
                     if folder.name in ('tree', 'phone_each_image_its_own_f')]
            patch.setattr(sky_cases, 'folders', lambda: cases)
        if request.param == 'user-mistakes':        # each is checked and calibrated twice
            patch.setattr(user_mistakes, 'ROWS', user_mistakes.ROWS[:2])
            patch.setattr(user_mistakes, 'CLEAN_RUNS', 1)
        return published.load(request.param).reproduce(
            SCENARIO, 2, tmp_path_factory.mktemp('work'), lambda part: None)


@pytest.mark.slow
def test_rows_fill_the_columns_and_the_notes_say_what_is_missing(outcome):
    assert outcome.rows and outcome.notes
    assert {len(row) for row in outcome.rows} == {len(outcome.columns)}
    json.dumps(outcome.as_dict(), allow_nan=False)


@pytest.mark.slow
@pytest.mark.parametrize('width', [50, 1000])
def test_table_shows_every_digit_however_narrow_the_terminal(outcome, width):
    console = Console(width=width, file=io.StringIO())
    console.print(report.published(outcome))
    assert '\N{HORIZONTAL ELLIPSIS}' not in console.file.getvalue()


@pytest.mark.slow
def test_what_is_drawn_is_finite(outcome):
    for panel in outcome.panels:
        for curve in panel.curves:
            assert len(curve.x) == len(curve.y) and np.isfinite([curve.x, curve.y]).all()


@pytest.mark.parametrize('name, column, state, paper', [
    ('table3', 'seed 1', 'f', 2e-5),
    ('table4', 'star_tracker.centroid_sigma_px = 0.2', 'v0', 0.182),
    ('table5', 'gyro.arw_deg_sqrt_h = 0.001', 'epsilon_y', 8.3e-4),
])
def test_table_has_the_number_of_the_paper(name, column, state, paper, tmp_path):
    table = published.load(name).reproduce(SCENARIO, 1, tmp_path, lambda part: None)
    rows = [dict(zip(table.columns, row)) for row in table.rows]
    assert {row['state'] for row in rows} == set(STATE_NAMES[CALIBRATED])
    row, = (row for row in rows if (row['column'], row['state']) == (column, state))
    assert row['paper'] == paper
    assert row['ratio'] == pytest.approx(row['ours'] / row['bound'])


@pytest.mark.parametrize('name, group, row, paper', [
    ('fig3', 'u0', 'px', 0.0546),
    ('fig3', 'k2', 'mm^-4', -7.37e-8),
    ('fig4', 'before', 'largest', 3.0),
    ('fig4', 'after', 'largest', 0.032),
    ('fig5', 'with stars, second half', 'phi_y', 0.31),
    ('fig6', 'used', 'u', 0.05),
    ('fig9', 'second half', "du0'", 0.0039),
    ('fig9', 'second half', "dv0'", 0.0005),
])
def test_figure_has_the_number_of_the_paper(name, group, row, paper, work):
    figure = published.load(name).reproduce(SCENARIO, 1, work, lambda part: None)
    found, = (dict(zip(figure.columns, cells)) for cells in figure.rows
              if cells[:2] == (group, row))
    assert found['paper'] == pytest.approx(paper, rel=1e-12)


@pytest.fixture(scope='module')
def work(tmp_path_factory):
    return tmp_path_factory.mktemp('shared')


def test_nominal_distortion_is_wrong_by_what_the_paper_states(work):
    """T18 Sec. 3.1: 3 px, to the digit given, at the edge of the detector."""
    rows = published.load('fig4').reproduce(SCENARIO, 1, work, lambda part: None).rows
    assert rows[0][4] == pytest.approx(3.0, abs=0.05)


def test_bound_of_the_distortion_is_the_spread_of_cameras_drawn_from_it(work, monkeypatch):
    """Cameras drawn from the bound itself: RMS within 4 sigma of 2000 draws, 7 % and less."""
    scenario = SCENARIO.replace({'simulation.duration_s': 60.0})
    covariance = bounds.after(scenario, [60.0])[0]
    scale = np.sqrt(np.diag(covariance))
    root = scale[:, None] * np.linalg.cholesky(covariance / np.outer(scale, scale))
    error = np.random.default_rng(4).standard_normal((2000, 1, 16)) @ root.T
    monkeypatch.setattr(traces, 'of', lambda *_: SimpleNamespace(error=error))
    rows = published.load('fig4').reproduce(scenario, 2000, work, lambda part: None).rows
    assert [row[1] for row in rows[1:]] == ['largest', 'mean square']
    for row in rows[1:]:
        assert row[6] == pytest.approx(1.0, abs=0.07)


def test_gyro_without_noise_has_no_walk_to_be_compared_with(work):
    quiet = SCENARIO.replace({'gyro.arw_deg_sqrt_h': 0.0})
    rows = published.load('fig5').reproduce(quiet, 1, work, lambda part: None).rows
    assert [row[5:] for row in rows if row[0] == 'drift without bias'] == [('-', '-')] * 3


def test_five_hours_are_parts_of_one_run_and_the_bound_falls_with_them(work):
    figure = published.load('fig8').reproduce(SCENARIO, 2, work, lambda part: None)
    rows = [dict(zip(figure.columns, row)) for row in figure.rows]
    times = [row['column'] for row in rows if row['state'] == 'v0']
    assert len(times) == 5
    assert [float(time[:-2]) * 3600.0 for time in times] == pytest.approx(
        [3.0, 6.0, 9.0, 12.0, 15.0], rel=1e-4)
    limits = [row['bound'] for row in rows if row['state'] == 'v0']
    assert limits == sorted(limits, reverse=True)
    assert [row['paper'] for row in rows if row['state'] == 'v0'] == ['-', 0.182, '-', '-', '-']


def test_first_errors_are_made_smaller_and_the_truth_stays():
    near = open_loop.nearer(SCENARIO, 0.25)
    truth = Truth.from_scenario(SCENARIO)
    np.testing.assert_allclose(Truth.from_scenario(near).vector(), truth.vector(), rtol=1e-15)
    true = nominal(truth, truth.motion.start_ns)
    whole, part = (dataclasses.replace(Filter(scenario).start, C_gi=true.C_gi).minus(true)
                   for scenario in (SCENARIO, near))
    np.testing.assert_allclose(part[CALIBRATED], 0.25 * whole[CALIBRATED], rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(whole[PSI] / ARCSEC, [100.0, 200.0, 300.0], atol=1e-3)   # Table 1


def test_open_loop_is_wrong_by_the_square_of_the_first_errors():
    """Two thirds of the first errors leave 4 / 9 of the difference to the filter with feedback."""
    scenario = SCENARIO.replace({'simulation.duration_s': 300.0})
    wrong = []
    for part in (1.0, 2.0 / 3.0):
        near = open_loop.nearer(scenario, part)
        feedback, plain = (run_batch(case, [1]).error[0, -1] for case in (
            near, near.replace({'estimator.feedback': False})))
        wrong.append(plain - feedback)
    p1, p2 = (STATE_NAMES.index(name) for name in ('p1', 'p2'))
    sigma = np.sqrt(np.diag(bounds.after(scenario, [300.0])[0]))
    assert abs(wrong[0][p2]) > 10.0 * sigma[p2]
    # the next order is a tenth of this one
    assert wrong[1][[p1, p2]] / wrong[0][[p1, p2]] == pytest.approx(4.0 / 9.0, rel=0.15)


def test_bias_that_can_not_be_met_is_said(tmp_path):
    table = published.load('table4').reproduce(SCENARIO, 1, tmp_path, lambda part: None)
    assert any('7.1e-4' in note and 'no unbiased estimator is better' in note
               for note in table.notes)


@pytest.mark.parametrize('part, below', [(0.5, 'in: f at 0.05.'), (0.9, 'nowhere.')])
def test_paper_below_the_bound_is_named(part, below, tmp_path):
    """A set of 100 runs has an RMS of half the bound never, of nine tenths often."""
    study = montecarlo.MonteCarlo(SCENARIO, 1, table4.KEY, (0.05,))
    bound = montecarlo.bound(SCENARIO) / UNIT
    paper = {name: (float(part * bound[k]) if name == 'f' else float(bound[k]),)
             for k, name in enumerate(STATE_NAMES)}
    outcome = table4.swept('', study, paper, (), tmp_path, lambda part: None)
    assert outcome.notes[1].endswith(below)
    assert all(isinstance(row[-1], float) for row in outcome.rows)


def test_a_bound_of_an_assumed_weight_has_no_ratio_and_nothing_is_below_it(tmp_path):
    study = montecarlo.MonteCarlo(SCENARIO, 1, table4.KEY, (0.0, 0.05))
    paper = {name: (0.0, 1e9) for name in STATE_NAMES}
    outcome = table4.swept('', study, paper, (), tmp_path, lambda part: None, (0.0,))
    assert {row[-1] for row in outcome.rows if row[0].endswith('= 0')} == {''}
    assert all(row[-1] > 0.0 for row in outcome.rows if row[0].endswith('= 0.05'))
    assert 'counts as one draw' in outcome.notes[0] and outcome.notes[1].endswith('nowhere.')
    report.published(outcome)


def test_command_prints_the_table_and_writes_it(tmp_path, capsys):
    out = tmp_path / 'tables.json'
    assert cli.main(['reproduce', 'table3', '--config', str(CONFIG), '--duration', '6',
                     '--out', str(out)]) == 0
    table = json.loads(out.read_text())['table3']
    assert table['title'] in capsys.readouterr().out
    assert table['rows'][0]['state'] == 'epsilon_x'
    assert table['provenance']['command'] == 'starcal reproduce table3 --config ' + str(
        CONFIG) + ' --duration 6.0 --runs 1'
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.slow
@pytest.mark.parametrize('outcome', ['real-sky'], indirect=True)
def test_real_skies_are_met_by_the_bundle(outcome):
    """The held-out images as well as ever, and own centroids as well as those of others."""
    rows = {row[:2]: dict(zip(outcome.columns, row)) for row in outcome.rows}
    for name, most in (('tomc16', 0.0885), ('granasat', 0.1126)):
        assert rows[name, 'bundle']['held out (px)'] < most + 5e-5
        of_both = rows[name, 'own centroids, stars of both'], rows[name, 'bundle, stars of both']
        for column in ('fitted (px)', 'held out (px)'):
            assert of_both[0][column] < 1.05 * of_both[1][column]
    cases = [row for (name, _), row in rows.items() if name == sky_cases.FOLDER]
    if not (REAL_SKY.parent / sky_cases.FOLDER).is_dir():
        pytest.skip('the pictures that others brought are not there')
    assert len(cases) == 2
    for row in cases:
        right, within = re.fullmatch(r'([\d.]+) \(([\d.]+)\)', row['reference f']).groups()
        assert abs(float(row['f (px)']) - float(right)) < float(within)
    phone = rows[sky_cases.FOLDER, 'phone_each_image_its_own_f']
    assert phone['sigma f'] == pytest.approx(1.7, rel=0.15)


def test_words_of_a_case_are_those_of_the_command():
    conditions = sky_cases._conditions('--fov 25.7 --site 45.5,-122.7,50, clock at UTC-7')
    assert conditions.fov_deg == 25.7 and conditions.site == Site(45.5, -122.7, 50.0)
    assert conditions.zone.utcoffset(None).total_seconds() == -7 * 3600
    assert sky_cases._conditions('') == Conditions()


def test_images_that_are_not_there_are_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(real_images.VARIABLE, str(tmp_path))
    assert cli.main(['reproduce', 'real-sky', '--out', str(tmp_path / 'x.json')]) == 2
    assert real_images.VARIABLE in capsys.readouterr().err


def test_studies_of_real_images_say_what_they_need(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv(real_images.VARIABLE)
    assert cli.main(['reproduce', 'half-real', '--out', str(tmp_path / 'x.json')]) == 2
    said = capsys.readouterr().err
    assert f'set {real_images.VARIABLE} to a folder that has tomc16/stars.csv and gran' in said


def test_command_draws_the_figure(tmp_path):
    out = tmp_path / 'figures.json'
    assert cli.main(['reproduce', 'fig9', '--duration', '6', '--runs', '2',
                     '--out', str(out)]) == 0
    assert sorted(tmp_path.iterdir()) == [tmp_path / 'fig9.png', out]
    assert (tmp_path / 'fig9.png').read_bytes().startswith(b'\x89PNG')


def test_unknown_table_is_refused_with_what_is_near(capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(['reproduce', 'table9'])
    assert ended.value.code == 2
    assert 'did you mean table5?' in capsys.readouterr().err
