# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The gyro buffer keeps what is needed, moves each reading once, and spoils nothing it gave."""

import numpy as np
import pytest

from starcal_ros.measurements.gyro_buffer import GyroBuffer
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.measurements.timeline import NEVER_NS


def samples(first, count):
    """Return readings stamped 10 * their number; the rate is the number."""
    number = np.arange(first, first + count)
    return GyroSamples(10 * number, np.repeat(number[:, None], 3, axis=1).astype(float))


@pytest.fixture
def buffer():
    buffer = GyroBuffer()
    buffer.add(samples(0, 100))
    return buffer


def test_an_empty_buffer_reaches_nothing_and_forgets_nothing():
    buffer = GyroBuffer()
    assert len(buffer) == len(buffer.everything) == len(buffer.since(5)) == 0
    assert buffer.newest_ns == NEVER_NS and not buffer.reaches(0)
    buffer.forget_before(100)
    buffer.keep_last(100)
    assert len(buffer) == 0


@pytest.mark.parametrize('stamp_ns, first', [(-5, 0), (0, 0), (9, 0), (10, 1), (19, 1), (990, 99),
                                             (2000, 99)])
def test_readings_since_a_stamp_begin_with_the_one_at_or_before_it(buffer, stamp_ns, first):
    np.testing.assert_array_equal(buffer.since(stamp_ns).stamp_ns, 10 * np.arange(first, 100))


def test_a_stamp_is_reached_by_a_reading_at_it(buffer):
    assert buffer.newest_ns == 990
    assert buffer.reaches(990) and not buffer.reaches(991)


def test_what_is_forgotten_is_what_would_not_be_given_again(buffer):
    since = buffer.since(555).stamp_ns.copy()
    buffer.forget_before(555)
    np.testing.assert_array_equal(buffer.everything.stamp_ns, since)
    buffer.forget_before(300)                       # is forgotten already
    np.testing.assert_array_equal(buffer.everything.stamp_ns, since)
    buffer.keep_last(100)
    np.testing.assert_array_equal(buffer.everything.stamp_ns, 10 * np.arange(89, 100))
    buffer.clear()
    assert len(buffer) == 0


@pytest.mark.parametrize('size', [1, 7, 1024, 5000])
def test_batches_of_any_size_give_the_same_readings(size):
    buffer, first = GyroBuffer(), 0
    for begin in range(0, 10_000, size):
        buffer.add(samples(begin, min(size, 10_000 - begin)))
        if begin % 3 == 0:
            first = max(begin - 2000, 0)
            buffer.forget_before(10 * first)
    np.testing.assert_array_equal(buffer.everything.rate[:, 0], np.arange(first, 10_000))
    np.testing.assert_array_equal(buffer.everything.stamp_ns, 10 * np.arange(first, 10_000))


def test_a_reading_is_moved_once_on_average_however_many_are_kept():
    """Arrays are made anew 8 times while 2^17 readings come one by one, and none is forgotten."""
    buffer, arrays = GyroBuffer(), {}
    for k in range(2**17):
        buffer.add(samples(k, 1))
        arrays[id(buffer.everything.stamp_ns.base)] = buffer.everything.stamp_ns.base
    assert len(arrays) <= 8
    assert np.shares_memory(buffer.since(50_000).rate, buffer.everything.rate)


def test_readings_at_a_standing_size_are_moved_once_on_average():
    """The last 2000 of 2^17 readings are kept: an array serves for 2000 at least."""
    buffer, arrays = GyroBuffer(), {}
    for k in range(2**17):
        buffer.add(samples(k, 1))
        buffer.keep_last(20_000)
        arrays[id(buffer.everything.stamp_ns.base)] = buffer.everything.stamp_ns.base
    assert len(arrays) <= 2 + 2**17 / 2000


def test_what_was_given_stays_as_it_was(buffer):
    given = buffer.since(0)
    expected = given.rate.copy()
    buffer.forget_before(980)
    for k in range(100, 5000):
        buffer.add(samples(k, 1))
    np.testing.assert_array_equal(given.rate, expected)
