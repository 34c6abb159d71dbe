# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a model is ranked first, and what can not be told is not chosen."""

import pytest

from instruments import TAN2018, calibrated, failed
from starcal_ros.filter import explanations
from starcal_ros.filter.candidates import pointed
from starcal_ros.filter.explanations import Explanations, Tried, explain
from starcal_ros.filter.offline import calibrate
from starcal_ros.measurements.message_source import InMemory, about, extent
from starcal_ros.reproduction import wrong_models
from starcal_ros.results.result import result, word
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

RUN = TAN2018.replace({'simulation.duration_s': 120.0, 'motion.dwell_s': 5.0})
SIGMA, WALK = 'star_tracker.centroid_sigma_px', 'gyro.arw_deg_sqrt_h'


def messages(row):
    spoilt = RUN.replace(dict(row.settings))
    gyro, tracker = sensors.gyro(spoilt), sensors.star_tracker(spoilt)
    return row.spoil(gyro.next(gyro.count), tracker.next(tracker.count),
                     Truth.from_scenario(spoilt))


def explained(row):
    given = messages(row)
    calibrator, _ = calibrate(*given, RUN)
    assert word(calibrator) == 'inconsistent'
    return given, calibrator, explain(InMemory(*given), RUN, calibrator)


@pytest.mark.parametrize('row, keys', [
    (wrong_models.late(5.0), {'estimator.augment.time_offset_sigma_s'}),
    (wrong_models.WrongModel('scale', {'truth.gyro.scale_factor_ppm': (500.0, 300.0, -400.0)}),
     {'estimator.augment.gyro_matrix_sigma_ppm'})], ids=['time offset', 'gyro matrix'])
def test_what_is_wrong_is_the_best_and_with_it_the_tests_pass(row, keys):
    given, _, found = explained(row)
    best = found.to_adopt
    assert best is found.tried[0] and set(best.values) == keys and best.beyond_chance
    assert best.numbers == (9 if 'gyro_matrix' in str(keys) else 1)
    assert [each.score for each in found.tried] == sorted(
        (each.score for each in found.tried), reverse=True)
    assert found.sentence == f'best explained by: {best.name}'
    after, _ = calibrate(*given, RUN.replace(best.values))
    assert failed(after) == set() and word(after) == 'not yet'


@pytest.mark.slow
def test_two_things_that_are_wrong_are_found_together():
    row = wrong_models.WrongModel('both', {
        'truth.star_tracker.time_offset_s': 0.005,
        'truth.gyro.scale_factor_ppm': (500.0, 300.0, -400.0)})
    given, _, found = explained(row)
    best = found.to_adopt
    assert set(best.values) == {'estimator.augment.time_offset_sigma_s',
                                'estimator.augment.gyro_matrix_sigma_ppm'}
    assert best.numbers == 10 and ' and ' in best.name
    after, _ = calibrate(*given, RUN.replace(best.values))
    assert failed(after) == set() and word(after) == 'not yet'


def test_noise_that_is_not_as_stated_points_to_the_levels_and_not_to_those_that_are_adapted():
    wrong = RUN.replace({'truth.star_tracker.centroid_sigma_px': 0.15})
    tests = calibrated(RUN, wrong).consistency

    def names(scenario):
        return {each.name: each for each in pointed(tests.statistics(), scenario, tests)}
    found = names(RUN)['other noise of the centroids']
    assert found.values == {'estimator.adapt': (SIGMA,)} and found.sought == (SIGMA,)
    assert 'other noise of the centroids' not in names(
        RUN.replace({'estimator.adapt': (SIGMA,)}))


def test_what_no_extension_explains_is_said_and_nothing_is_to_be_adopted():
    calibrator = calibrated(RUN)
    found = explain(InMemory(*messages(wrong_models.CLEAN)), RUN, calibrator)
    assert found == Explanations((), (), False, 0.0) and found.to_adopt is None
    assert found.sentence == 'no extension of the model is known for what fails'
    assert 'explanations' not in result(calibrator, {})
    told = result(calibrator, {}, explained=found)['explanations']
    assert told['to_adopt'] is None and told['tried'] == []


def tried(name, score, beyond=True, numbers=1, **values):
    return Tried(name, values or {name: 1.0}, numbers, score + 7.0 * numbers, score, beyond)


def test_of_two_that_are_as_good_neither_is_adopted_unless_they_are_equal_in_effect():
    one, other, worse = tried('a', 100.0), tried('b', 95.0), tried('c', 50.0)
    best = explanations._best([one, other, worse], 3)
    assert best == (one, other)
    apart = Explanations((one, other, worse), best, False, 900.0)
    assert apart.to_adopt is None
    assert apart.sentence == 'explained as well by: a; b; the data do not tell them apart'
    alike = Explanations((one, other, worse), best, True, 900.0)
    assert alike.to_adopt is one and 'equal in effect' in alike.sentence


def test_what_adds_to_another_has_to_be_better_beyond_chance():
    single = tried('one', 100.0, **{'estimator.adapt': (SIGMA,)})
    double = tried('two', 104.0, numbers=2, **{'estimator.adapt': (SIGMA, WALK)})
    assert explanations._best([double, single], 2) == (single,)
    better = double._replace(score=150.0, gain=164.0)
    assert explanations._best([better, single], 2) == (better,)


def test_what_chance_explains_is_no_explanation():
    found = Explanations((tried('a', 3.0, beyond=False),), explanations._best(
        [tried('a', 3.0, beyond=False)], 1), False, 900.0)
    assert found.best == () and found.to_adopt is None
    assert found.sentence == 'no extension of the model explains the data better than chance would'


def test_equal_in_effect_is_judged_by_states_and_sigmas():
    short = RUN.replace({'simulation.duration_s': 40.0})
    one = calibrated(short)
    other = calibrated(short.replace({'estimator.process_noise.k1_sqrt_h': 1e-12}))
    assert explanations._alike([one, other])
    assert not explanations._alike([one, calibrated(short.replace(
        {'estimator.process_noise.gyro_bias_deg_h_sqrt_h': 5.0}))])


def test_the_stretch_is_about_what_failed_first_and_inside_the_recording():
    source = InMemory(*messages(wrong_models.CLEAN))
    run = extent(source)
    for at_s, low_s in ((0.0, 0.0), (80.0, 50.0), (119.0, 59.5)):
        found = about(source, run, 60.0, run.first_ns + round(at_s * 1e9))
        samples, part = found.gyro, found.frames
        assert (part.stamp_ns[0] - run.first_ns) * 1e-9 == pytest.approx(low_s, abs=0.5)
        assert (part.stamp_ns[-1] - part.stamp_ns[0]) * 1e-9 == pytest.approx(60.0, abs=0.6)
        assert samples.stamp_ns[0] <= part.stamp_ns[0] + 10**7
        assert samples.stamp_ns[-1] <= part.stamp_ns[-1] + 10**9
    assert len(about(source, run, 1e4, run.first_ns).frames) == run.frames


@pytest.mark.parametrize('value, text', [
    (0.01, '0.01'), (2e-5, '2.0e-05'), (500.0, '500.0'), ((SIGMA, WALK), f'[{SIGMA}, {WALK}]')])
def test_lines_are_as_ros_2_reads_them(value, text):
    assert Tried('a', {'key': value}, 1, 0.0, 0.0, False).lines == (f'key: {text}',)
