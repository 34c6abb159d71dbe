# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is asked for again is not worked out again; anything else is."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from starcal_ros.core.remembered import remembered


@dataclass(frozen=True)
class Scale:
    by: np.ndarray
    name: str = 'a'


@pytest.fixture
def asked():
    return []


@pytest.fixture
def scaled(asked):
    @remembered
    def function(x, scale):
        asked.append(x.copy())
        return x * scale.by, x + 1.0
    return function


def test_equal_questions_are_answered_once(scaled, asked):
    first = scaled(np.arange(3.0), Scale(np.array([2.0])))
    assert scaled(np.arange(3.0), Scale(np.array([2.0]))) is first
    assert len(asked) == 1


@pytest.mark.parametrize('x, scale', [
    (np.arange(3.0) + 1e-16, Scale(np.array([3.0]))), (np.arange(3), Scale(np.array([2.0]))),
    (np.arange(3.0)[:, None], Scale(np.array([2.0]))),
    (np.arange(3.0), Scale(np.array([2.0]), 'b'))])
def test_any_other_question_is_worked_out(scaled, asked, x, scale):
    scaled(np.arange(3.0), Scale(np.array([2.0])))
    found = scaled(x, scale)
    assert len(asked) == 2
    np.testing.assert_array_equal(found[0], x * scale.by)


def test_what_is_asked_with_may_change_afterwards(scaled):
    x, scale = np.arange(3.0), Scale(np.array([2.0]))
    scaled(x, scale)
    x[0] = 5.0
    np.testing.assert_array_equal(scaled(x, scale)[0], [10.0, 2.0, 4.0])
    np.testing.assert_array_equal(scaled(x, replace(scale, by=np.ones(1)))[0], x)


def test_an_answer_can_not_be_written_to(scaled):
    with pytest.raises(ValueError):
        scaled(np.arange(3.0), Scale(np.array([2.0])))[0][0] = 1.0
