# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What frames gave is the same in columns and one by one."""

from dataclasses import fields

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.simulation import sensors

RUN = TAN2018.replace({'simulation.duration_s': 60.0})
STARS = ('uv_raster', 'residual', 'chi2', 'accepted', 'catalog_id', 'sigma')


@pytest.fixture(scope='module')
def stretches():
    """Return what the frames of a run gave, of which the last were done many at once."""
    gyro, tracker = sensors.gyro(RUN), sensors.star_tracker(RUN)
    calibrator = Calibrator(RUN)
    calibrator.add_gyro(gyro.next(gyro.count))
    calibrator.add_frames(tracker.next(tracker.count))
    found = list(calibrator.stretches())
    assert len(found[0]) == 1 and max(map(len, found)) > 20 and sum(map(len, found)) == 120
    return found


def same(left, right):
    for name in ('stamp_ns', 'nis', 'turn', 'linear', *STARS):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
    np.testing.assert_array_equal(left.belief.root, right.belief.root)
    for name in left.belief.nominal.names():
        np.testing.assert_array_equal(getattr(left.belief.nominal, name),
                                      getattr(right.belief.nominal, name))


@pytest.mark.parametrize('rows', [slice(None), slice(3), slice(2, 9, 3), slice(-1, None),
                                  slice(5, 5)])
def test_some_are_those_of_all(stretches, rows):
    many = max(stretches, key=len)
    some, each = many.take(rows), list(many)[rows]
    assert len(some) == len(each)
    for left, right in zip(some, each):
        same(left, right)


def test_one_alone_is_one_of_many(stretches):
    for result in list(max(stretches, key=len))[:3]:
        same(result, next(iter(result.alone)))
        assert {field.name for field in fields(result.alone)} == {*result._fields, 'seen'}


def test_another_belief_comes_after_the_last_alone(stretches):
    many = max(stretches, key=len)
    first, *_, last = many
    other = many.ending_with(first.belief)
    same(next(iter(other)), first)
    np.testing.assert_array_equal(other.belief.root[-1], first.belief.root)
    np.testing.assert_array_equal(other.belief.root[:-1], many.belief.root[:-1])
    np.testing.assert_array_equal(other.residual, many.residual)
    assert (last.belief.root != first.belief.root).any()
