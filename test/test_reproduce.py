# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Each table can be reproduced, and says the numbers of the paper beside ours."""

import json
from pathlib import Path

import pytest

from starcal_ros import cli, parameter_file
from starcal_ros.estimator import CALIBRATED, STATE_NAMES
from starcal_ros.evaluation import published, real_images

CONFIG = Path(__file__).parents[1] / 'config' / 'tan2018.yaml'
SKY = Path(__file__).parents[2] / 'shared' / 'data' / 'real_sky'
SCENARIO = parameter_file.load(CONFIG).replace({'simulation.duration_s': 6.0})


@pytest.fixture(autouse=True, scope='module')
def real_sky():
    """Say where the star images of others are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(real_images.VARIABLE, str(SKY))
        yield


@pytest.fixture(scope='module', params=published.names())
def outcome(request, tmp_path_factory):
    """Return what a table gives in a run that is far too short."""
    if request.param in ('real-sky', 'half-real') and not SKY.is_dir():
        pytest.skip(f'{SKY} is not there')
    return published.load(request.param).reproduce(
        SCENARIO, 2, tmp_path_factory.mktemp('work'), lambda part: None)


def test_rows_fill_the_columns_and_the_notes_say_what_is_missing(outcome):
    assert outcome.rows and outcome.notes
    assert {len(row) for row in outcome.rows} == {len(outcome.columns)}
    assert all(value == value for row in outcome.rows for value in row)


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


def test_bias_that_can_not_be_met_is_said(tmp_path):
    table = published.load('table4').reproduce(SCENARIO, 1, tmp_path, lambda part: None)
    assert any('7.1e-4' in note and 'can not be met' in note for note in table.notes)


def test_command_prints_the_table_and_writes_it(tmp_path, capsys):
    out = tmp_path / 'tables.json'
    assert cli.main(['reproduce', 'table3', '--config', str(CONFIG), '--duration', '6',
                     '--out', str(out)]) == 0
    table = json.loads(out.read_text())['table3']
    assert table['title'] in capsys.readouterr().out
    assert table['rows'][0]['state'] == 'epsilon_x'
    assert list(tmp_path.iterdir()) == [out]


def test_real_skies_are_met_by_the_bundle(tmp_path):
    if not SKY.is_dir():
        pytest.skip(f'{SKY} is not there')
    outcome = published.load('real-sky').reproduce(SCENARIO, 1, tmp_path, lambda part: None)
    heldout = {row[0]: row[outcome.columns.index('held out (px)')] for row in outcome.rows
               if row[1] == 'bundle'}
    assert heldout['tomc16'] <= 0.10 and heldout['granasat'] <= 0.14


def test_images_that_are_not_there_are_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(real_images.VARIABLE, str(tmp_path))
    assert cli.main(['reproduce', 'real-sky', '--out', str(tmp_path / 'x.json')]) == 2
    assert real_images.VARIABLE in capsys.readouterr().err


def test_unknown_table_is_refused_with_the_known_ones(capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(['reproduce', 'table9'])
    assert ended.value.code == 2
    assert 'table4' in capsys.readouterr().err
