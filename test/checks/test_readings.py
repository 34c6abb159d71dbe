# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the numbers of the gyro say by themselves."""

import numpy as np

from instruments import TAN2018
from starcal_ros.checks.readings import of_readings
from starcal_ros.core.units import DEG_PER_HOUR
from starcal_ros.measurements.samples import GyroSamples

N = 6000
STAMPS = 10_000_000 * np.arange(N) + 10**18
RATE = (0.3 * np.sin(np.arange(N)[:, None] / [300.0, 500.0, 700.0])
        + 1e-6 * np.random.default_rng(1).standard_normal((N, 3)))


def found(rate):
    return list(of_readings(GyroSamples(STAMPS, rate), TAN2018))


def kinds(rate):
    return [each.kind for each in found(rate)]


def test_readings_that_change_are_right():
    assert found(RATE) == []


def test_readings_that_say_nothing():
    assert kinds(0.0 * RATE) == ['all zero']
    assert kinds(0.0 * RATE + 0.25) == ['frozen']
    one = RATE.copy()
    one[:, 1] = 0.5
    assert 'about y' in found(one)[0].sentence
    part = RATE.copy()
    part[2000:2500] = part[2000]
    assert kinds(part) == ['frozen'] and '5.0 s, from 20.0 s' in found(part)[0].sentence
    bad = RATE.copy()
    bad[7] = np.nan
    assert kinds(bad) == ['not finite']


def test_readings_that_repeat_or_stop_at_a_limit():
    repeated, = found(np.repeat(RATE[::2], 2, axis=0))
    assert repeated.kind == 'repeated readings' and abs(repeated.value[0] - 0.5) < 1e-3
    saturated, = found(np.clip(RATE, -0.25, 0.25))
    assert saturated.kind == 'saturated' and set(np.abs(saturated.value)) == {0.25}


def test_readings_that_are_rounded_too_coarsely_and_those_that_are_not():
    coarse, = found(np.rint(RATE / 1e-3) * 1e-3)
    assert coarse.kind == 'quantisation'
    assert abs(coarse.value[0] * DEG_PER_HOUR - 1e-3) < 1e-9
    assert found(np.rint(RATE / 1e-7) * 1e-7) == []
