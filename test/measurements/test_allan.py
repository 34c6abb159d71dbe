# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The Allan deviation of a gyro: published values, simulated noise, and what is not known."""

import math

import numpy as np
import pytest

from starcal_ros.measurements.allan import TERMS, allan

pytest.importorskip('allantools')

NAMES = [term.name for term in TERMS]


def noise(seed, n, rate_hz, **of):
    """Return readings [deg/h] with noise after IEEE Std 952, each coefficient in its unit."""
    rng, dt = np.random.default_rng(seed), 1.0 / rate_hz / 3600.0
    rate = of.get('N', 0.0) / math.sqrt(dt) * rng.standard_normal(n)
    rate += of.get('K', 0.0) * math.sqrt(dt) * np.cumsum(rng.standard_normal(n))
    rate += of.get('Q', 0.0) / 3600.0 * np.diff(rng.standard_normal(n + 1)) / dt
    rate += of.get('R', 0.0) * dt * np.arange(n)
    frequency = np.fft.rfftfreq(2 * n, dt)[1:]          # B^2/(2 pi f), two-sided
    size = of.get('B', 0.0) / np.sqrt(2.0 * np.pi * frequency) * math.sqrt(n / dt)
    spectrum = size * (rng.standard_normal((2, len(size))) * [[1.0], [1j]]).sum(axis=0)
    return rate + np.fft.irfft(np.append(0.0, spectrum), 2 * n)[:n]


def known(curve):
    """Return the coefficients that are known, by name."""
    return {name: found for name, found in zip(NAMES, curve.coefficients)
            if found.value is not None}


def test_deviations_are_those_of_the_published_test_suite():
    """NIST SP 1065, Table 31 and 32: 1000 numbers, at 1 (overlapping) and 10 (adjacent)."""
    state, numbers = 1234567890, []
    for _ in range(1000):
        numbers.append(state / 2147483647)
        state = 16807 * state % 2147483647
    assert allan(np.array(numbers), 1.0).deviation[0] == pytest.approx(2.922319e-1, rel=1e-6)
    tens = np.reshape(numbers, (100, 10)).mean(axis=1)
    assert allan(tens, 0.1).deviation[0] == pytest.approx(9.965736e-2, rel=1e-6)


@pytest.mark.parametrize('of, name', [
    ({'N': 0.1}, 'angle random walk'), ({'Q': 2.0}, 'quantisation'),
    ({'B': 3.0}, 'bias instability'), ({'K': 5.0}, 'rate random walk'),
    ({'R': 40.0, 'N': 0.01}, 'rate ramp')])
def test_a_noise_alone_has_the_deviation_of_the_standard(of, name):
    """At 16 readings, by the formula of each noise in IEEE Std 952-1997, Annex C."""
    curve = allan(noise(2, 2**16, 10.0, **of), 10.0)
    tau = 1.6 / 3600.0
    expected = {'quantisation': math.sqrt(3.0) * 2.0 / 3600.0 / tau,
                'angle random walk': 0.1 / math.sqrt(tau),
                'bias instability': 3.0 * math.sqrt(2.0 * math.log(2.0) / math.pi),
                'rate random walk': 5.0 * math.sqrt(tau / 3.0),
                'rate ramp': math.hypot(40.0 * tau / math.sqrt(2.0), 0.01 / math.sqrt(tau))}[name]
    assert curve.tau_s[4] == pytest.approx(1.6)
    assert curve.deviation[4] == pytest.approx(expected, rel=0.05)
    (value, low, high), = [curve.coefficients[NAMES.index(name)]]
    assert low < list(of.values())[0] < high and low < value < high


@pytest.mark.slow
def test_the_intervals_hold_the_truth_and_no_noise_is_invented():
    """60 gyros with four kinds of noise, 60 with one; 0.95 is what the intervals promise."""
    truth = {'quantisation': 0.5, 'angle random walk': 0.1, 'bias instability': 1.0,
             'rate random walk': 2.0}
    held, invented = [], []
    for seed in range(60):
        curve = allan(noise(seed, 2**16, 20.0, Q=0.5, N=0.1, B=1.0, K=2.0), 20.0)
        held.append([low <= truth[name] <= high for name, (_, low, high)
                     in zip(NAMES, curve.coefficients) if name in truth])
        alone = allan(noise(seed, 2**15, 20.0, N=0.1), 20.0)
        assert 'angle random walk' in known(alone)
        invented.append(len(known(alone)) > 1)
    # Of 60, 52 or more with a chance of 0.997 where 0.95 is true.
    assert (np.sum(held, axis=0) >= 52).all()
    assert np.sum(invented) <= 3


def test_what_a_recording_is_too_short_for_is_not_known_but_bounded():
    """Rate random walk of 2 deg/h/sqrt(h): not in two minutes, in eleven hours."""
    short = allan(noise(3, 2400, 20.0, N=0.1, K=2.0), 20.0)
    assert list(known(short)) == ['angle random walk']
    value, low, high = short.coefficients[NAMES.index('rate random walk')]
    assert value is None and low == 0.0 and high > 2.0
    long = allan(noise(3, 800_000, 20.0, N=0.1, K=2.0), 20.0)
    assert list(known(long)) == ['angle random walk', 'rate random walk']


def test_noise_that_is_none_of_the_five_is_told():
    """A gyro behind a filter of 1.6 Hz, read at 50 Hz; its slow part is white all the same."""
    white, slow = noise(1, 2**17, 50.0, N=0.1), []
    for value in white:
        slow.append(0.8 * slow[-1] + 0.2 * value if slow else value)
    assert allan(white, 50.0).fits and not allan(np.array(slow), 50.0).fits


@pytest.mark.parametrize('rate, said', [
    (np.zeros(1000), 'they do not change'), (np.arange(63.0), '63 readings at rest')])
def test_what_is_no_noise_is_refused(rate, said):
    with pytest.raises(ValueError, match=said):
        allan(rate, 10.0)
