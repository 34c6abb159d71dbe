# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled attitude between frames is that of the reference, in whatever steps."""

import numpy as np
import pytest

from starcal_ros.core import rotation
from starcal_ros.filter import track_kernel, track_reference
from starcal_ros.filter.track_reference import Attained
from starcal_ros.measurements.samples import GyroSamples


@pytest.mark.parametrize('first', [0, 2, 5, 11])
@pytest.mark.parametrize('since', [2, -3])
def test_what_is_attained_between_frames_is_that_of_the_reference(first, since):
    """With silences, with readings that were given before, and from the first reading on."""
    rng = np.random.default_rng(first)
    steps = rng.choice([9_900_000, 10_000_000, 15_000_000, 15_000_001, 70_000_000], 30)
    stamps = 10**18 + np.cumsum(steps)
    gyro = GyroSamples(stamps, 0.3 * rng.normal(size=(30, 3)))
    begins_ns = stamps[since] + 10**6 if since > 0 else stamps[0] - 2 * 10**7
    start = Attained(np.array([min(begins_ns, stamps[first])]),
                     rotation.exp(rng.normal(size=(1, 3))), np.zeros((1, 3)),
                     rng.normal(size=(1, 3)), np.array([0.3]))
    for last in (first + 1, 30):
        given = (gyro, first, last, start, 1e-3 * rng.normal(size=3),
                 np.eye(3) + 1e-3 * rng.normal(size=(3, 3)), 1e7)
        for left, right in zip(track_kernel.integrate(*given),
                               track_reference.integrate(*given)):
            np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-11)


def test_attitudes_are_attained_in_whatever_steps():
    rng = np.random.default_rng(1)
    gyro = GyroSamples(10**18 + 10**7 * np.arange(30), 0.3 * rng.normal(size=(30, 3)))
    start = Attained(gyro.stamp_ns[:1], np.eye(3)[None], *(np.zeros((1, 3)),) * 2, np.zeros(1))
    by = np.zeros(3), np.eye(3), 1e7
    whole, parts, at = track_kernel.integrate(gyro, 0, 30, start, *by), [], start
    for low, high in ((0, 1), (1, 12), (12, 30)):
        parts.append(track_kernel.integrate(gyro, low, high, at, *by))
        at = parts[-1].last
    for left, right in zip(whole, map(np.concatenate, zip(*parts))):
        np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize('m', [0, 3])
def test_the_spread_between_frames_is_that_of_the_reference(m):
    rng = np.random.default_rng(m)
    given = (*rng.normal(size=(2, 3, 16 + m)), 0.1 * rng.normal(size=(7, 3, 16 + m)),
             rng.random(7), rng.random(7))
    np.testing.assert_allclose(track_kernel.spread(*given), track_reference.spread(*given),
                               rtol=1e-12)
