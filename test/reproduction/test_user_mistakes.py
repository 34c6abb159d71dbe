# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The study of users' mistakes: its rows, what adopting a proposal does, the foreign recording."""

import json

import numpy as np
import pytest

from instruments import EXTERNAL, TAN2018
from starcal_ros.checks.check import check
from starcal_ros.checks.finding import proposed
from starcal_ros.config.parameter import ConfigError
from starcal_ros.reproduction import mistake_trial
from starcal_ros.reproduction.published import user_mistakes as study
from starcal_ros.reproduction.user_mistakes import INSTRUMENTS, ROWS

SCENARIO = TAN2018.replace({'simulation.duration_s': 120.0, 'motion.dwell_s': 2.0,
                            'motion.rate_deg_s': 2.0})
BY_NAME = {row.name: row for row in ROWS}


def test_there_are_many_mistakes_and_each_has_its_name():
    assert len(BY_NAME) == len(ROWS) >= 60
    assert all(row.kinds for row in ROWS)


@pytest.mark.parametrize('name', ['rates in deg/s', 'gyro z reversed', 'frames 400 ms late'])
def test_what_a_driver_must_do_mends_the_calibration(name):
    judged = mistake_trial.run(BY_NAME[name], study.simulated(SCENARIO, 1), 1)
    assert judged.right and not judged.wrong
    assert judged.words[0] not in ('converged', 'not yet') and judged.words[1] == 'not yet'
    assert judged.after < 4.5


def test_a_large_time_offset_is_stated_and_with_it_nothing_is_found():
    source = study.simulated(SCENARIO, 1)
    gyro, frames = BY_NAME['frames 400 ms late'].spoil(
        source.gyro, source.frames, np.random.default_rng(1))
    found = check(gyro, frames, source.scenario).findings
    offset, = (each.parameters['star_tracker.time_offset_s'] for each in found)
    assert offset == pytest.approx(0.4, abs=2e-4)
    assert not check(gyro, frames, proposed(source.scenario, found)).findings


def test_the_study_tabulates_mistakes_and_counts_false_alarms(tmp_path, monkeypatch):
    monkeypatch.setattr(study, 'ROWS', (BY_NAME['mounting inverse'],))
    monkeypatch.setattr(study, 'INSTRUMENTS', {'as configured': INSTRUMENTS['as configured']})
    monkeypatch.setattr(study, 'CLEAN_RUNS', 1)
    monkeypatch.delenv(study.FOREIGN, raising=False)
    outcome = study.reproduce(SCENARIO, 1, tmp_path / 'parts', lambda part: None)
    told = outcome.as_dict()
    row, = told['rows']
    assert (row['recording'], row['named right'], row['other names']) == ('simulated', 1, '-')
    assert row['error after, sigma'] < 4.5
    assert (told['false_alarms'], told['right_runs']) == (0, 1)
    assert any(study.FOREIGN in note for note in told['notes'])
    json.dumps(told, allow_nan=False)


def test_a_folder_without_a_truth_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv(study.FOREIGN, str(tmp_path))
    with pytest.raises(ConfigError, match='config.yaml'):
        study.foreign_folder()


@pytest.mark.skipif(not EXTERNAL.is_dir(), reason='not part of the checkout')
def test_a_mistake_in_a_recording_of_others_is_named():
    known = study.foreign_recording(EXTERNAL)
    judged = mistake_trial.run(BY_NAME['gyro x and y swapped'], known, 1)
    assert judged.right and not judged.wrong and judged.after < 4.5
