# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Steps and drifts are dated, named and sized, and what follows them is honest."""

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.filter.changes import N_EFFECTS, SLOTS, STRIDE, Changes
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.hypotheses import CHANGING, HYPOTHESES
from starcal_ros.filter.model_tests import ModelTests
from starcal_ros.filter.responses import Responses
from starcal_ros.reproduction import wrong_models
from starcal_ros.results.result import result

RUN = TAN2018.replace({'simulation.duration_s': 500.0, 'motion.dwell_s': 5.0})
LONG = RUN.replace({'simulation.duration_s': 900.0})
BEGIN_NS, HALF_NS = 1_782_993_600 * 10**9, 450 * 10**9


def steps_of(row, seed=1, scenario=RUN):
    judged = wrong_models.run(row, scenario, seed)
    return judged, judged.calibrator.consistency.changes


def later(scenario, frames):
    """Return a scenario in which the step comes so many frames later."""
    return scenario.replace({'simulation.duration_s': scenario.simulation.duration_s + frames})


@pytest.mark.parametrize('row, what, size, within', [
    (wrong_models.bias_step(1.0), CHANGING[0], (1.0, 0.0, 0.0), 30.0),
    (wrong_models.bias_step(0.1), CHANGING[0], (0.1, 0.0, 0.0), 60.0),
    (wrong_models.focal_step(5.0), CHANGING[3], (0.0, 0.0, 5.0), 30.0),
    (wrong_models.tracker_turned(10.0), CHANGING[1], (10.0, 0.0, 0.0), 60.0)],
    ids=['bias 1', 'bias 0.1', 'focal length', 'mounting'])
def test_a_step_is_dated_named_and_sized_and_the_errors_after_it_are_honest(
        row, what, size, within):
    judged, changes = steps_of(row, scenario=later(LONG, 1))       # where a candidate begins
    change, = changes
    assert change.kind == 'step' and change.what[0] == what
    assert abs(change.since_ns - BEGIN_NS - HALF_NS) * 1e-9 < within
    assert 0.0 < (change.found_ns - change.since_ns) * 1e-9 <= 2.0 * within
    error = (np.array(change.size) - size) / change.sigma
    assert np.abs(error).max() < 4.0
    assert np.abs(judged.error).max() < 4.5 and judged.nees < 48.0     # 1e-4 of 16
    assert judged.failed == () and judged.word == 'not yet'
    notices = judged.calibrator.take_notices()
    assert any(change.sentence in text and 'opened' in text for text in notices)


@pytest.mark.slow
@pytest.mark.parametrize('frames', [2, 3, 19])
def test_a_step_that_has_just_happened_at_a_look_is_named_at_the_next(frames):
    """After a frame or two of it, a bias that changed ten seconds ago explains as much."""
    row = wrong_models.tracker_turned(10.0)
    judged, changes = steps_of(row, scenario=later(LONG, frames))
    change, = changes
    assert CHANGING[1] in change.what
    assert np.abs(judged.error).max() < 4.5 and judged.nees < 48.0
    assert judged.failed == () and judged.word == 'not yet'


def test_a_step_that_large_turns_would_explain_as_well_is_answered_by_a_small_one():
    """In a slow turn the gyros' mounting, turned by 200 degrees, does what a bias does."""
    judged, changes = steps_of(wrong_models.bias_step(1.0), seed=2, scenario=TAN2018.replace(
        {'simulation.duration_s': 3600.0}))
    change, = changes
    assert CHANGING[0] in change.what
    assert all(np.abs(size) <= 3600.0 for size in change.size)
    assert judged.word == 'converged' and np.abs(judged.error).max() < 4.5


@pytest.mark.parametrize('turned, names, word', [
    (wrong_models.tracker_turned, CHANGING[1], 'inconsistent'),
    (wrong_models.gyros_turned, CHANGING[2], 'converged')], ids=['star tracker', 'gyros'])
def test_a_turn_that_loses_the_attitude_is_among_what_is_named(turned, names, word):
    """Two degrees fit a step of the bias better, to first order."""
    judged, changes = steps_of(turned(7200.0), scenario=TAN2018.replace(
        {'simulation.duration_s': 3600.0}))
    change, = changes
    assert names in change.what and judged.word == word
    assert np.abs(judged.error).max() < (10.0 if word == 'inconsistent' else 4.5)


def test_a_slow_change_is_told_from_a_step_and_its_state_walks_from_then_on():
    def spoil(gyro, frames, truth):
        hours = (gyro.stamp_ns - gyro.stamp_ns[0]) * 1e-9 / 3600.0
        rate = gyro.rate + np.outer(hours, [0.0, 1.0 * np.pi / 180.0 / 3600.0, 0.0])
        return type(gyro)(gyro.stamp_ns, rate), frames
    judged, changes = steps_of(wrong_models.WrongModel('drift', spoil=spoil))
    assert [change.kind for change in changes] == ['drift']
    assert changes[0].what == (CHANGING[0],) and judged.word == 'not yet'
    assert abs(changes[0].size[1] - 1.0) < 4 * changes[0].sigma[1]
    assert (judged.calibrator.filter.density[:3] > 0.0).any()
    assert not judged.calibrator.filter.density[3:].any()


def test_without_leave_to_answer_the_step_fails_its_test():
    judged, changes = steps_of(
        wrong_models.bias_step(1.0), scenario=RUN.replace({'estimator.answer_changes': False}))
    assert changes == [] and judged.word == 'inconsistent'
    assert 'step of the gyro bias' in judged.failed


def test_a_second_step_soon_after_the_first_is_not_answered():
    """Three stars beside their places look like steps of the camera, time and again."""
    judged, changes = steps_of(wrong_models.displaced(3, 8.0))
    assert len(changes) <= 1 and judged.word == 'inconsistent'


@pytest.mark.parametrize('row', [
    wrong_models.late(5.0),
    wrong_models.WrongModel('walk x 10', {'truth.gyro.arw_deg_sqrt_h': 0.01}),
    wrong_models.WrongModel('noise x 3', {'truth.star_tracker.centroid_sigma_px': 0.15})],
    ids=lambda row: row.name)
def test_what_is_wrong_from_the_beginning_is_no_step(row):
    judged, changes = steps_of(row)
    assert changes == [] and judged.word in ('inconsistent', 'lost')


def test_a_right_model_has_no_steps_and_is_let_alone_to_the_bit():
    judged, changes = steps_of(wrong_models.CLEAN)
    without, _ = steps_of(wrong_models.CLEAN,
                          scenario=RUN.replace({'estimator.answer_changes': False}))
    assert changes == [] and judged.failed == ()
    np.testing.assert_array_equal(judged.calibrator.belief.root, without.calibrator.belief.root)


def test_candidates_grow_old_by_a_like_factor_at_constant_number():
    responses = Responses((), 16, np.ones((len(HYPOTHESES) + N_EFFECTS, 3)))
    changes = Changes()
    for k in range(200 * STRIDE):
        if changes.due(k):
            changes.begin(k, True, responses)
    ages = 200 * STRIDE - np.sort(changes._starts)
    assert len(ages) == SLOTS and ages[-1] <= STRIDE + 1 and ages[0] >= 199 * STRIDE
    assert changes.begun == 199                         # the first frame begins none
    assert (ages[:-2] / ages[1:-1]).max() < 2.5


def test_a_belief_is_opened_by_what_the_step_did():
    filter_ = Filter(RUN)
    belief = filter_.begin(np.eye(3))
    error, columns = np.zeros(16), np.zeros((16, 1))
    error[3], columns[3] = 2.0, 1e6
    opened = filter_.opened(belief, error, columns)
    np.testing.assert_allclose(opened.nominal.bias[0],
                               belief.nominal.bias[0] - 2.0 * filter_.scale[3])
    np.testing.assert_allclose(opened.root @ opened.root.T,
                               belief.root @ belief.root.T + columns @ columns.T, rtol=1e-6)


def test_the_result_has_the_changes_and_json_can_hold_them():
    judged, _ = steps_of(wrong_models.focal_step(5.0))
    outcome = result(judged.calibrator, {})
    change, = outcome['changes']
    assert change['kind'] == 'step' and change['what'] == ['camera']
    assert set(change) == {'kind', 'what', 'since_ns', 'within_s', 'found_ns', 'numbers', 'size',
                           'sigma', 'sentence'}


def test_history_is_kept_and_bounded(monkeypatch):
    monkeypatch.setattr('starcal_ros.filter.model_tests.HISTORY', 10)
    tests = ModelTests(Filter(RUN), 0.9999)
    for stamp_ns in range(1000):
        tests._keep(stamp_ns)
    stamps = [stamp_ns for stamp_ns, _ in tests.history]
    assert 5 <= len(stamps) < 10 and stamps[-1] > 850 and len(set(np.diff(stamps))) == 1
