# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Each row of the study of wrong models, for ten minutes at most: what is wrong is said."""

import json

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.filter import verdict
from starcal_ros.filter.hypotheses import HYPOTHESES
from starcal_ros.reproduction import wrong_models
from starcal_ros.reproduction.published import wrong_models as study
from starcal_ros.reproduction.wrong_models import CLEAN, ROWS
from starcal_ros.results.result import result

SCENARIO = TAN2018.replace({'simulation.duration_s': 600.0, 'motion.dwell_s': 5.0})
SHORT = SCENARIO.replace({'simulation.duration_s': 400.0})
NAMED = {
    'star stamps 5 ms late': 'time offset of the frames',
    'star stamps 2 ms late': 'time offset of the frames',
    'gyro clock 10 ppm fast': 'time offset of the frames',
    'both stamps from boot': 'velocity of the observer',
    'both stamps half a year off': 'velocity of the observer',
    'angular random walk 3 times the stated': 'correlation of turns from frame to frame',
    'angular random walk 10 times the stated': 'NIS of the turns',
    'gyro scale of 300 ppm': 'gyro scale factors',
    '3 stars displaced by 8 arcsec': 'displacement of the worst star',
    'centroid noise 3 times the stated': 'NIS of the rest',
    'centroid noise 0.6 of the stated': 'NIS of the rest',
    'pixel-phase error of 0.05 px': 'pixel phase along u',
    'orbit believed at the geocentre': 'velocity of the observer'}
"""Rows that are wrong from the beginning, and a statistic that fails."""
ANSWERED = {
    'bias step of 1 deg/h': 'gyro bias', 'bias step of 0.1 deg/h': 'gyro bias',
    'focal length step of 5 um': 'camera',
    'mounting step of 10 arcsec': 'mounting of the star tracker',
    'gyros turned by 10 arcsec': 'mounting of the gyros',
    'focal length +-0.0001 with the orbit': 'camera'}
"""Rows in which something changes on the way."""


@pytest.mark.slow
@pytest.mark.parametrize('row', [row for row in ROWS if row.name in NAMED],
                         ids=lambda row: row.name)
def test_what_is_wrong_is_named_and_can_not_have_converged(row):
    judged = wrong_models.run(row, SHORT, 1)
    assert NAMED[row.name] in judged.failed
    if NAMED[row.name] in {each.name for each in HYPOTHESES}:
        assert judged.failed[0].split(' along')[0] == NAMED[row.name].split(' along')[0]
    # Where the stars scatter so much that the gate rejects most of a frame, it is lost as well.
    assert judged.word in ('inconsistent', 'lost') and judged.alarm_s < 400.0
    outcome = json.loads(json.dumps(result(judged.calibrator, {}), allow_nan=False))
    assert outcome['verdict'] == judged.word and outcome['converged'] is False
    assert {each['name'] for each in outcome['consistency'] if not each['passed']} == set(
        judged.failed)
    calibrator = judged.calibrator
    said = verdict.judge(calibrator.filter, calibrator.belief, calibrator.tracking,
                         calibrator.consistency.statistics())
    assert said.word == judged.word and not said.converged
    assert said.summary.startswith(('inconsistent: ', 'lost: '))


@pytest.mark.parametrize('row', [row for row in ROWS if row.name in ANSWERED],
                         ids=lambda row: row.name)
def test_what_changes_is_named_and_the_errors_are_honest_or_it_is_inconsistent(row):
    judged = wrong_models.run(row, SCENARIO, 1)
    assert np.isfinite(judged.alarm_s) and judged.word != 'converged'
    if judged.word == 'not yet':
        change, = judged.calibrator.consistency.changes
        assert ANSWERED[row.name] in change.what
        assert np.abs(judged.error).max() < 5.0


def test_every_row_has_its_test():
    named = {*NAMED, *ANSWERED, '10 % wrong stars and 20 s of silence'}
    assert {row.name for row in ROWS} == named


def test_wrong_stars_and_silences_together_leave_the_errors_honest():
    row, = (row for row in ROWS if row.name == '10 % wrong stars and 20 s of silence')
    judged = wrong_models.run(row, SCENARIO.replace({'simulation.duration_s': 1300.0}), 1)
    assert judged.nees < 48.0 and np.abs(judged.error).max() < 4.5     # 1e-4 of 16


@pytest.mark.slow
def test_the_study_tabulates_the_rows_and_counts_false_alarms(tmp_path, monkeypatch):
    monkeypatch.setattr(study, 'ROWS', (ROWS[0],))
    monkeypatch.setattr(study, 'CLEAN_RUNS', 2)
    scenario = SCENARIO.replace({'simulation.duration_s': 90.0})
    outcome = study.reproduce(scenario, 1, tmp_path / 'parts', lambda part: None)
    rows = outcome.as_dict()
    assert [row['what is wrong'] for row in rows['rows']] == [ROWS[0].name, CLEAN.name]
    late, right = rows['rows']
    assert late['inconsistent'] == 1 and late['clearest statistic or change'] == (
        'time offset of the frames')
    assert right['not yet'] == 2 and right['alarm after, s'] == 'never'
    assert (rows['false_alarms'], rows['right_runs'], rows['confidently_wrong']) == (0, 2, [])
    json.dumps(rows, allow_nan=False)
