# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What an estimator said, out of its recording and out of RESULT.json."""

import json

import numpy as np
import pytest

from estimated import record_results
from instruments import TAN2018
from starcal_ros.filter import verdict
from starcal_ros.filter.states import CALIBRATED, UNIT
from starcal_ros.live import facts, recorded
from starcal_ros.live.finished import finished
from starcal_ros.live.recorded import moments
from starcal_ros.messages import topics
from starcal_ros.messages.cdr import RecordError
from starcal_ros.messages.conventions import state_vector
from starcal_ros.recording.writer import Writer
from starcal_ros.results import result
from starcal_ros.results.document import CalibrationError
from starcal_ros.simulation.write_recording import simulate

SCENARIO = TAN2018.replace({'simulation.duration_s': 30.0})


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    """Return a recording of results, and the calibrator at its end."""
    path = tmp_path_factory.mktemp('run') / 'run.mcap'
    return path, record_results(path, SCENARIO)


def test_each_frame_of_a_short_recording_is_a_moment_with_its_own_stars(run):
    path, calibrator = run
    found = list(moments(path))
    assert len(found) == 60
    assert [each.stamp_ns for each in found] == sorted({each.stamp_ns for each in found})
    np.testing.assert_array_equal(
        found[-1].seen.state, state_vector(calibrator.stamp_ns, calibrator.belief))
    assert len({each.seen.stars.tobytes() for each in found}) == 60
    for number, each in enumerate(found):
        assert each.seen.values['frames'] == str(number // 2 * 2 + 1)
        assert each.seen.size == (1024, 1024) and facts.silence(each.seen) == ''


def test_moments_of_a_long_recording_are_spread_over_all_of_it(run, monkeypatch):
    whole = list(moments(run[0]))
    monkeypatch.setattr(recorded, 'MOST', 4)
    few = list(moments(run[0]))
    assert [each.stamp_ns for each in few] == [whole[k].stamp_ns for k in (0, 19, 39, 59)]
    for each, k in zip(few, (0, 19, 39, 59)):
        np.testing.assert_array_equal(each.seen.state, whole[k].seen.state)
        np.testing.assert_array_equal(each.seen.stars, whole[k].seen.stars)
        assert each.seen.values == whole[k].seen.values


def test_the_part_that_has_been_read_grows_to_all_of_it(run):
    parts = []
    list(moments(run[0], on_progress=parts.append))
    assert parts == sorted(parts) and parts[-1] == 1.0


def test_of_several_estimators_one_is_chosen(tmp_path):
    left, both = tmp_path / 'left.mcap', tmp_path / 'both'
    record_results(left, SCENARIO, '/left')
    assert len(list(moments(left))) == len(list(moments(left, 'left'))) == 60
    with pytest.raises(RecordError, match='no results .* in /right; --name.* one of /left$'):
        list(moments(left, '/right'))
    with Writer(both) as writer:
        for name in ('', '/left'):
            writer.write(name + topics.STATE.recorded, topics.STATE.type_name, b'', 1)
    with pytest.raises(RecordError, match='2 estimators: --namespace chooses one of /, /left'):
        list(moments(both))


def test_a_recording_of_sensors_says_what_to_do(tmp_path):
    path = tmp_path / 'run.mcap'
    simulate(SCENARIO, path)
    with pytest.raises(RecordError, match='calibrate it, starcal calibrate BAG --out'):
        list(moments(path))


def test_a_message_that_can_not_be_read_is_named(tmp_path):
    path = tmp_path / 'run.mcap'
    with Writer(path) as writer:
        writer.write(topics.STATE.recorded, topics.STATE.type_name, b'\0\1\0\0\7', 1)
    with pytest.raises(RecordError, match='a message of /starcal/state cannot be read'):
        list(moments(path))


# RESULT.json


@pytest.fixture
def outcome(run):
    """Return RESULT.json of the same run."""
    return result.result(run[1], {})


def written(tmp_path, outcome):
    """Return the file of a result."""
    path = tmp_path / 'result.json'
    path.write_text(json.dumps(outcome))
    return path


def test_a_result_says_what_the_estimator_said_at_the_end(run, tmp_path, outcome):
    path, calibrator = run
    last, seen = list(moments(path))[-1].seen, finished(written(tmp_path, outcome))
    # its attitude is of the last reading, not of the last frame
    np.testing.assert_allclose(seen.state[4:17], last.state[4:17], rtol=1e-9)
    np.testing.assert_array_equal(seen.state[17:], last.state[17:])
    assert seen.size == last.size and seen.stars is None
    judged = verdict.of(calibrator)
    assert seen.message == judged.summary and facts.advice(seen) == judged.advice
    np.testing.assert_allclose(seen.tolerances()[3:],
                               calibrator.filter.tolerance / UNIT[CALIBRATED], rtol=1e-5)
    assert [test.name for test in facts.tests(seen)] == [
        each.name for each in judged.statistics]
    assert facts.counts(seen)['frames'] == '60'
    assert finished(tmp_path.joinpath('result.json')).values == seen.values


def test_the_folder_of_a_saved_calibration_is_read(tmp_path, outcome):
    written(tmp_path, outcome)
    tmp_path.joinpath('config.yaml').write_text('/**:\n  ros__parameters: {}\n')
    assert finished(tmp_path).values['verdict'] == outcome['verdict']


@pytest.mark.parametrize('word, level', [('converged', 0), ('not yet', 0), ('inconsistent', 2),
                                         ('lost', 2)])
def test_the_level_of_a_result_is_that_of_its_verdict(tmp_path, outcome, word, level):
    outcome |= {'verdict': word, 'advice': ''}
    seen = finished(written(tmp_path, outcome))
    assert seen.level == level and seen.message.partition(':')[0] == word


@pytest.mark.parametrize('spoil', [
    lambda outcome: outcome.pop('tolerance'), lambda outcome: outcome.pop('consistency'),
    lambda outcome: outcome['attitude_final'].pop('quaternion_xyzw'),
    lambda outcome: outcome.update(counts=3),
    lambda outcome: outcome['tolerance']['intrinsics_sigma'].pop('k1')])
def test_what_is_no_result_is_said(tmp_path, outcome, spoil):
    outcome = json.loads(json.dumps(outcome))
    spoil(outcome)
    with pytest.raises(CalibrationError, match='result.json: is no result of a calibration'):
        finished(written(tmp_path, outcome))


def test_a_camera_alone_is_refused(tmp_path, outcome):
    alone = {key: outcome[key] for key in ('intrinsics', 'intrinsics_sigma', 'counts')}
    alone['covariance'] = np.eye(7).tolist()
    with pytest.raises(CalibrationError, match='is of a camera alone'):
        finished(written(tmp_path, alone))
