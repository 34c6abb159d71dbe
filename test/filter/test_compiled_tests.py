# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is asked in compiled form has the answers that the tests of the model give in words."""

from functools import cache

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.core.statistic import ALARM, chi2_beyond, normal_beyond
from starcal_ros.filter import compiled_tests
from starcal_ros.filter.allowances import WINDOW
from starcal_ros.filter.changes import CLEAN, N_EFFECTS, SLOTS, STRIDE, Changes
from starcal_ros.filter.hypotheses import HYPOTHESES
from starcal_ros.filter.responses import Responses
from starcal_ros.reproduction import wrong_models

RUN = TAN2018.replace({'simulation.duration_s': 300.0, 'motion.dwell_s': 5.0})
ROWS = {row.name: row for row in (
    wrong_models.CLEAN, wrong_models.bias_step(1.0), wrong_models.late(5.0),
    wrong_models.displaced(3, 8.0),
    wrong_models.WrongModel('walk x 10', {'truth.gyro.arw_deg_sqrt_h': 0.01}),
    wrong_models.WrongModel('noise x 1.5', {'truth.star_tracker.centroid_sigma_px': 0.075}))}


@cache
def judged_by(name):
    """Return the tests at the end of a run in which nothing is answered."""
    scenario = RUN.replace({'estimator.answer_changes': False})
    return wrong_models.run(ROWS[name], scenario, 1).calibrator.consistency


def asked(tests):
    """Return whether the compiled form has all pass of the innovations, and of the effects."""
    sums, fit = tests.sums(), tests._fit()
    return (compiled_tests.as_expected(
        sums.run, sums.worst, sums.seen, tests.gated, sums.star_frames, sums.star_sums,
        sums.cell_count, sums.cell_squares, sums.magnitude_count, sums.magnitude_squares),
        compiled_tests.harmless(sums.E[0], tests._root, fit.p, fit.gain, fit.freedom,
                                tests._changes.begun))


def in_words(tests):
    own = tests._tests[()]
    return (own.frames >= WINDOW and all(each.passed for each in own.statistics()),
            all(each.counted <= each.bound for each in tests._effects((), tests._fit())))


@pytest.mark.parametrize('name', ROWS)
def test_all_pass_or_not_as_in_words(name):
    """As they are, and with each kind of sum made larger step by step, up to where it fails."""
    tests = judged_by(name)
    sums = tests.sums()
    assert asked(tests) == in_words(tests)
    assert (asked(tests) == (True, True)) == (name == wrong_models.CLEAN.name)
    seen = {True: 0, False: 0}
    for part in ('run', 'worst', 'star_sums', 'cell_squares', 'magnitude_squares', 's'):
        array = getattr(sums, part)
        whole = array.copy()
        places = {'run': range(3, 11), 'worst': range(2)}.get(part, [...])
        for place in places:
            for factor in (*np.geomspace(0.1, 0.9, 5), *np.geomspace(1.02, 30.0, 25)):
                array[place] = whole[place] * factor
                assert asked(tests) == in_words(tests), (part, place, factor)
                seen[all(asked(tests))] += 1
                array[:] = whole
    for rejected in (0, 10**4, 10**9):
        sums.seen[1] += rejected
        assert asked(tests) == in_words(tests)
        sums.seen[1] -= rejected
    for losses in (3, 4):
        sums.seen[2] += losses
        assert asked(tests) == in_words(tests)
        sums.seen[2] -= losses
    if name == wrong_models.CLEAN.name:
        assert min(seen.values()) > 50


def test_too_few_frames_are_not_clean():
    tests = judged_by(wrong_models.CLEAN.name)
    run = tests.sums().run
    frames = run[0]
    run[0] = WINDOW - 1
    assert asked(tests)[0] is False and in_words(tests)[0] is False
    run[0] = frames


@pytest.mark.parametrize('name', ROWS)
def test_what_may_be_seen_is_what_is_found(name):
    """With the scores of each effect made larger until it stands out, clean before it or not."""
    tests = judged_by(name)
    changes, sums = tests._changes, tests.sums()
    told = set()
    slots, s = changes.slots.copy(), sums.s.copy()
    for clean in (True, False):
        changes.slots[:, CLEAN] = clean
        for effect in range(len(HYPOTHESES) - 10, len(HYPOTHESES) + 12):
            for factor in (1.0, 3.0, 10.0, 30.0, 100.0):
                sums.s[0, effect] = s[0, effect] * factor
                fit = tests._fit()
                found = changes._told(10**18, fit, tests._responses, True) is not None
                assert compiled_tests.stands_out(
                    fit.gain, fit.freedom, changes.slots, changes.counts) == found
                told.add(found)
                sums.s[:] = s
    changes.slots[:] = slots
    assert told == {True, False}


def test_candidates_begin_as_those_of_changes():
    both = []
    for compiled in (True, False):
        changes, n = Changes(), len(HYPOTHESES) + N_EFFECTS
        responses = Responses((), 16, np.ones((n, 3)))
        for part in (responses.E, responses.s, responses.information):
            part[:] = 1.0
        begun = []
        for k in range(100 * STRIDE):
            stamp_ns = 1_782_993_600 * 10**9 + k * 500_000_000
            if not (compiled_tests.due(stamp_ns, changes.counts) if compiled
                    else changes.due(stamp_ns)):
                continue
            begun.append(k)
            clean = bool(k % 3)
            if compiled:
                compiled_tests.begin(stamp_ns, clean, changes.slots, changes.counts, responses.E,
                                     responses.s, responses.information)
            else:
                changes.begin(stamp_ns, clean, responses)
            for part in (responses.s, responses.information):
                part += 1.0
        both.append((changes, responses, begun))
    (ours, left, k_ours), (theirs, right, k_theirs) = both
    assert k_ours == k_theirs and len(k_ours) == 99 > SLOTS
    np.testing.assert_array_equal(ours.slots, theirs.slots)
    np.testing.assert_array_equal(ours.counts, theirs.counts)
    for name in ('E', 's', 'information'):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))


@pytest.mark.parametrize('tried', [1, 7, 5000])
def test_probabilities_are_those_of_the_quantiles(tried):
    for freedom in (1, 2, 3):
        limit = chi2_beyond(ALARM / tried, freedom)
        assert compiled_tests._chance(limit, freedom) == pytest.approx(ALARM / tried, rel=1e-9)
    far = normal_beyond(ALARM / 2.0 / tried)
    assert compiled_tests._usual(-far * (1.0 - 1e-9), tried)
    assert not compiled_tests._usual(far * (1.0 + 1e-9), tried)
    assert not compiled_tests._usual(np.nan, tried)
