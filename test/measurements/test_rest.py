# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where a gyro is at rest: motion, silences, stamps, and gyros of many kinds."""

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.measurements.rest import longest_rest
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.simulation import sensors

COUNT = 20_000
STAMP_NS = 10**18 + np.arange(COUNT) * 10**7
SECONDS = np.arange(COUNT) / 100.0
QUIET = 1e-3 * np.random.default_rng(1).standard_normal((COUNT, 3))


def rest_of(rate=QUIET, stamp_ns=STAMP_NS):
    """Return the stretch at rest of readings at 100 Hz."""
    return longest_rest(GyroSamples(stamp_ns, rate))


def wave(amplitude, hz):
    """Return a sine about x."""
    return amplitude * np.sin(2.0 * np.pi * hz * SECONDS)[:, None] * [1.0, 0.0, 0.0]


def test_the_rest_before_the_first_rotation_of_T18_is_found():
    rest = longest_rest(sensors.gyro(TAN2018).next(50_000))
    assert rest.readings == slice(0, 3000) and rest.rate_hz == pytest.approx(100.0)
    assert 'not at rest' in rest.notices[0] and '0.0 to 30.0 s of 500.0 s' in rest.notices[0]


@pytest.mark.parametrize('rate', [
    QUIET, QUIET + 1e-3, np.round(QUIET / 2e-3) * 2e-3, np.round(QUIET / 1e-2 + 0.4) * 1e-2,
    QUIET + np.cumsum(1e-2 * QUIET, axis=0), QUIET + np.linspace(0.0, 1e-3, COUNT)[:, None],
    np.diff(np.concatenate((QUIET, QUIET[:1])), axis=0), (QUIET + np.roll(QUIET, 1, axis=0)) / 2],
    ids=['white', 'bias', 'quantised', 'coarse', 'walk', 'ramp', 'angle', 'filtered'])
def test_a_gyro_at_rest_is_at_rest_whatever_its_noise(rate):
    rest = rest_of(rate)
    assert rest.readings == slice(0, COUNT) and rest.notices == ()


def test_a_knock_divides_the_rest():
    rate = QUIET.copy()
    rate[5000:5050] += 0.05
    rest = rest_of(rate)
    assert rest.readings == slice(5100, COUNT) and rest.begin_s == pytest.approx(51.0)


@pytest.mark.parametrize('rate, said', [
    (QUIET + wave(0.3, 0.3), 'nowhere at rest'), (QUIET + wave(0.3, 2.3), 'nowhere at rest'),
    (QUIET + np.radians(2.0), 'nowhere at rest: it turns at 2, 2, 2 deg/s'),
    (np.zeros((COUNT, 3)), 'about x never change'), (QUIET[:20], '20 gyro readings, too few')])
def test_where_there_is_no_rest_it_is_said(rate, said):
    with pytest.raises(ValueError, match=said):
        rest_of(rate, STAMP_NS[:len(rate)])


def test_a_rate_that_may_be_a_bias_or_a_turn_is_said():
    assert rest_of(QUIET - QUIET.mean(axis=0) + np.radians(0.5)).notices == (
        'it reads 0.5, 0.5, 0.5 deg/s on the mean: a bias, or does it turn?',)


def test_no_stretch_goes_across_a_silence():
    stamp_ns = STAMP_NS.copy()
    stamp_ns[6000:] += 3 * 10**9
    rest = rest_of(stamp_ns=stamp_ns)
    assert rest.readings == slice(6000, COUNT) and rest.rate_hz == pytest.approx(100.0)
    assert rest.notices[0] == 'the gyro is silent 1 times, for 3.010 s at most'
    stamp_ns = STAMP_NS.copy()
    stamp_ns[6000:] -= 3 * 10**9
    assert 'the stamps stand or go back, 1 times' in rest_of(stamp_ns=stamp_ns).notices


@pytest.mark.parametrize('stamp_ns', [
    STAMP_NS[::10].repeat(10), STAMP_NS + np.random.default_rng(2).integers(-4e6, 4e6, COUNT)],
    ids=['bursts', 'jitter'])
def test_irregular_stamps_are_said_and_the_mean_rate_counts(stamp_ns):
    rest = rest_of(stamp_ns=stamp_ns)
    assert 'the stamps are irregular' in rest.notices[0]
    assert rest.readings == slice(0, COUNT) and rest.rate_hz == pytest.approx(100.0, rel=1e-3)


def test_stamps_that_stand_are_refused():
    with pytest.raises(ValueError, match='do not increase'):
        rest_of(stamp_ns=np.full(COUNT, 10**18))
