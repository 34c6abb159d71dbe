# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gyro samples composed between stamps: against products one by one, and exact cases."""

import numpy as np
import pytest
from scipy.stats import chi2

from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.units import DEG_PER_SQRT_HOUR
from starcal_ros.measurements import preintegration
from starcal_ros.measurements.preintegration import preintegrate
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.simulation.gyro import GyroSimulator
from starcal_ros.simulation.truth import Truth

PERIOD_NS = 10**7
START_NS = 1_782_993_600_000_000_000
BIAS = np.array([1e-3, -2e-3, 3e-3])
CONSTANT = np.array([0.1, -0.2, 0.3])

# A product of n rotations, each rounded at a few 1e-16, is good to some n * 1e-16 at worst.
ROUNDING_100 = 1e-13


def ns(*seconds):
    return START_NS + np.rint(np.array(seconds) * 1e9).astype(np.int64)


def regular(n=100, rate=None):
    """Return n readings at 100 Hz, the first ending 10 ms after the start."""
    if rate is None:
        rate = np.random.default_rng(1).normal(scale=0.1, size=(n, 3))
    return GyroSamples(START_NS + PERIOD_NS * np.arange(1, n + 1), np.broadcast_to(rate, (n, 3)))


def irregular():
    """Return readings at intervals of 0.3 to 1.4 periods: no silence."""
    rng = np.random.default_rng(2)
    steps = rng.integers(3 * PERIOD_NS // 10, 14 * PERIOD_NS // 10, 120)
    steps[0] = PERIOD_NS                            # the first begins at the start
    return GyroSamples(START_NS + np.cumsum(steps), rng.normal(scale=0.1, size=(120, 3)))


def by_hand(gyro, begin_ns, end_ns, bias=BIAS):
    """Compose readings one by one, each clipped to the interval; returns Delta."""
    starts = np.concatenate(([gyro.stamp_ns[0] - PERIOD_NS], gyro.stamp_ns[:-1]))
    Delta = np.eye(3)
    for low, high, rate in zip(starts, gyro.stamp_ns, gyro.rate):
        dt = 1e-9 * (min(high, end_ns) - max(low, begin_ns))
        if dt > 0.0:
            Delta = rotation.exp(-(rate - bias) * dt) @ Delta
    return Delta


@pytest.fixture(params=['regular', 'irregular'])
def gyro(request):
    return {'regular': regular, 'irregular': irregular}[request.param]()


# Off the gyro grid, of many lengths, one shorter than a sampling interval, one empty.
CUTS = ns(0.0, 0.0123456, 0.5, 0.503, 0.503, 0.78901, 0.85)


# Delta

def test_delta_is_the_product_of_the_exponentials(gyro):
    result = preintegrate(gyro, CUTS, BIAS, PERIOD_NS)
    assert len(result.Delta) == len(CUTS) - 1
    for k in range(len(CUTS) - 1):
        np.testing.assert_allclose(result.Delta[k], by_hand(gyro, CUTS[k], CUTS[k + 1]),
                                   atol=ROUNDING_100)
    np.testing.assert_allclose(result.duration, np.diff(CUTS) * 1e-9, rtol=1e-15)
    np.testing.assert_array_equal(result.gap_turn, 0.0)


def test_delta_takes_the_attitude_from_one_stamp_to_the_next_with_the_sign_of_a_rate_of_g():
    """Turning at w about z, the gyro sees a fixed direction turn by -w t: C_gi = Rz(-w t)."""
    gyro = regular(rate=[0.0, 0.0, np.pi / 2])
    result = preintegrate(gyro, ns(0.0, 1.0), np.zeros(3), PERIOD_NS)
    np.testing.assert_allclose(result.Delta[0] @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0],
                               atol=ROUNDING_100)


@pytest.mark.parametrize('t', [1e-9, 0.0042, 0.01, 0.333333333, 0.999999999])
def test_a_cut_between_readings_splits_a_constant_rate_exactly(t):
    result = preintegrate(regular(rate=CONSTANT), ns(0.0, t, 1.0), np.zeros(3), PERIOD_NS)
    np.testing.assert_allclose(result.Delta[0], rotation.exp(-CONSTANT * t), atol=ROUNDING_100)
    np.testing.assert_allclose(result.Delta[1], rotation.exp(-CONSTANT * (1.0 - t)),
                               atol=ROUNDING_100)


def test_the_bias_is_taken_off():
    result = preintegrate(regular(rate=CONSTANT + BIAS), ns(0.0, 1.0), BIAS, PERIOD_NS)
    np.testing.assert_allclose(result.Delta[0], rotation.exp(-CONSTANT), atol=ROUNDING_100)


def test_two_intervals_compose_to_the_whole(gyro):
    a, b, c = ns(0.0021, 0.31, 0.84)
    parts = preintegrate(gyro, np.array([a, b, c]), BIAS, PERIOD_NS)
    whole = preintegrate(gyro, np.array([a, c]), BIAS, PERIOD_NS)
    np.testing.assert_allclose(whole.Delta[0], parts.Delta[1] @ parts.Delta[0],
                               atol=ROUNDING_100)
    np.testing.assert_allclose(whole.J[0], parts.J[0] + parts.Delta[0].T @ parts.J[1],
                               atol=ROUNDING_100)


def test_an_empty_interval_does_nothing(gyro):
    for result in (preintegrate(gyro, ns(0.4, 0.4), BIAS, PERIOD_NS),
                   preintegrate(gyro, ns(0.1, 0.4, 0.4, 0.5), BIAS, PERIOD_NS)):
        empty = result.duration == 0.0
        assert empty.sum() == 1
        np.testing.assert_array_equal(result.Delta[empty], [np.eye(3)])
        np.testing.assert_array_equal(result.J[empty], np.zeros((1, 3, 3)))
        np.testing.assert_array_equal(result.gap_turn[empty], 0.0)


def test_readings_before_and_after_the_cuts_do_not_matter(gyro):
    cuts = ns(0.2345, 0.3, 0.4567)
    first = int(np.searchsorted(gyro.stamp_ns, cuts[0], side='right')) - 1
    last = int(np.searchsorted(gyro.stamp_ns, cuts[-1])) + 1
    for all_readings, needed in zip(preintegrate(gyro, cuts, BIAS, PERIOD_NS),
                                    preintegrate(gyro[first:last], cuts, BIAS, PERIOD_NS)):
        np.testing.assert_array_equal(all_readings, needed)


def test_many_intervals_are_those_of_a_few_at_a_time():
    n = 2500
    gyro = regular(n + 1)
    cuts = START_NS + 3_000_000 + PERIOD_NS * np.arange(n + 1)
    whole = preintegrate(gyro, cuts, BIAS, PERIOD_NS)
    for low in range(0, n, 700):
        rows = slice(low, min(low + 700, n))
        part = preintegrate(gyro, cuts[low:rows.stop + 1], BIAS, PERIOD_NS)
        for all_cuts, some in zip(whole, part):
            np.testing.assert_array_equal(all_cuts[rows], some)


def test_track_ends_where_preintegrate_does(gyro):
    C_gi = rotation.exp(np.array([0.5, -1.0, 2.0]))
    cuts = ns(0.0123, 0.8)
    pieces = preintegration.cut(gyro, cuts, PERIOD_NS)
    attitude = preintegration.track(C_gi, pieces, BIAS)
    np.testing.assert_allclose(
        attitude[-1], preintegrate(gyro, cuts, BIAS, PERIOD_NS).Delta[0] @ C_gi,
        atol=ROUNDING_100)
    inside = (gyro.stamp_ns > cuts[0]) & (gyro.stamp_ns < cuts[1])
    np.testing.assert_array_equal(pieces.end_ns, [*gyro.stamp_ns[inside], cuts[1]])


# The bias Jacobian

def test_jacobian_agrees_with_central_differences(gyro):
    """Eq. (P.1), Delta(b + eps) = Delta(b) exp([J eps x])."""
    h = 1e-4
    result = preintegrate(gyro, CUTS, BIAS, PERIOD_NS)

    def moved(step):
        Delta = preintegrate(gyro, CUTS, BIAS + step, PERIOD_NS).Delta
        return rotation.log(np.swapaxes(result.Delta, -1, -2) @ Delta)

    numeric = np.stack([(moved(h * axis) - moved(-h * axis)) / (2 * h) for axis in np.eye(3)],
                       axis=-1)
    # h^2 J^3 < 1e-9 s, and the rounding of the logarithm 1e-15 over 2 h
    np.testing.assert_allclose(result.J, numeric, atol=2e-9)


def test_jacobian_at_rest_is_the_duration():
    result = preintegrate(regular(rate=np.zeros(3)), ns(0.0, 0.25, 1.0), np.zeros(3), PERIOD_NS)
    np.testing.assert_allclose(result.J, np.array([0.25, 0.75])[:, None, None] * np.eye(3),
                               rtol=1e-14)


def test_jacobian_has_the_sign_of_an_attitude_error():
    """An estimate too large by eps, in g, turns the estimated C_gi by +J eps, at rest by t eps."""
    eps = np.array([1e-4, 0.0, 0.0])
    estimated = preintegrate(regular(rate=np.zeros(3)), ns(0.0, 1.0), eps, PERIOD_NS).Delta[0]
    np.testing.assert_allclose(rotation.log(estimated), eps, atol=ROUNDING_100)


# Silence

def silent(begin=20, end=70):
    """Return readings of which those after `begin` up to `end` are missing; of two rates."""
    gyro = regular(rate=[0.1, 0.0, 0.0])
    rate = np.where(np.arange(100)[:, None] < begin, gyro.rate, 3.0 * gyro.rate)
    keep = np.r_[0:begin, end:100]
    return GyroSamples(gyro.stamp_ns[keep], rate[keep])


def test_a_silence_is_bridged_by_the_mean_of_its_neighbours():
    """0.20 s at 0.1, 0.50 s at 0.2 and 0.30 s at 0.3 rad/s, all about x."""
    result = preintegrate(silent(), ns(0.0, 1.0), np.zeros(3), PERIOD_NS)
    turn = 0.20 * 0.1 + 0.50 * 0.2 + 0.30 * 0.3
    np.testing.assert_allclose(rotation.log(result.Delta[0]), [-turn, 0.0, 0.0],
                               atol=ROUNDING_100)


def test_a_silence_may_hide_half_its_square():
    result = preintegrate(silent(), ns(0.0, 1.0), BIAS, PERIOD_NS)
    np.testing.assert_allclose(result.gap_turn, [0.5 * 0.5**2], rtol=1e-12)


def test_a_silence_cut_by_frames_adds_up():
    """From 0.2 s to 0.7 s; the rate, too, has drifted for longer in the later frames."""
    result = preintegrate(silent(), ns(0.0, 0.1, 0.3, 0.45, 1.0), BIAS, PERIOD_NS)
    np.testing.assert_allclose(
        result.gap_turn, [0.0, 0.5 * 0.1**2, 0.5 * (0.25**2 - 0.1**2), 0.5 * (0.5**2 - 0.25**2)],
        atol=1e-15)
    whole = preintegrate(silent(), ns(0.0, 1.0), BIAS, PERIOD_NS)
    np.testing.assert_allclose(result.gap_turn.sum(), whole.gap_turn[0], rtol=1e-12)
    Delta = np.eye(3)
    for step in result.Delta:
        Delta = step @ Delta
    np.testing.assert_allclose(Delta, whole.Delta[0], atol=ROUNDING_100)


def test_a_first_cut_inside_a_silence_remembers_its_beginning():
    """The silence goes from 0.2 s to 0.7 s, between 0.1 and 0.3 rad/s."""
    result = preintegrate(silent(), ns(0.45, 1.0), np.zeros(3), PERIOD_NS)
    np.testing.assert_allclose(result.gap_turn, [0.5 * (0.5**2 - 0.25**2)], rtol=1e-12)
    np.testing.assert_allclose(rotation.log(result.Delta[0]),
                               [-(0.25 * 0.2 + 0.30 * 0.3), 0.0, 0.0], atol=ROUNDING_100)


@pytest.mark.parametrize('missing, hidden', [(0, 0.0), (1, 0.01), (2, 0.02)])
def test_a_reading_that_is_missing_is_a_silence_and_none_else(missing, hidden):
    """A reading after a silence covers one nominal interval, the rest is bridged."""
    result = preintegrate(silent(50, 50 + missing), ns(0.0, 1.0), BIAS, PERIOD_NS)
    np.testing.assert_allclose(result.gap_turn, [0.5 * hidden**2], atol=1e-15)


@pytest.mark.parametrize('step, hidden', [(1.49, 0.0), (1.51, 0.51)])
def test_an_interval_of_one_and_a_half_is_the_longest_that_a_reading_covers(step, hidden):
    gyro = GyroSamples(ns(0.0, 0.01, 0.01 + 0.01 * step), np.zeros((3, 3)))
    result = preintegrate(gyro, gyro.stamp_ns[[0, 2]], BIAS, PERIOD_NS)
    np.testing.assert_allclose(result.gap_turn, [0.5 * (0.01 * hidden)**2], atol=1e-15)


def test_before_the_first_reading_is_a_silence_of_its_rate():
    """Readings from 0.41 s (it covers 0.40 to 0.41), the first frame at 0.15 s."""
    gyro = regular(rate=CONSTANT)[40:]
    result = preintegrate(gyro, ns(0.15, 0.25, 1.0), np.zeros(3), PERIOD_NS)
    np.testing.assert_allclose(result.Delta, rotation.exp(-CONSTANT * [[0.1], [0.75]]),
                               atol=ROUNDING_100)
    np.testing.assert_allclose(result.gap_turn, [0.5 * (0.25**2 - 0.15**2), 0.5 * 0.15**2],
                               rtol=1e-12)


def test_what_hides_before_the_first_reading_does_not_depend_on_the_first_cut():
    """A node has one frame after the other, a recording all at once."""
    gyro = regular(rate=CONSTANT)[40:]
    all_at_once = preintegrate(gyro, ns(0.0, 0.15, 0.25, 1.0), np.zeros(3), PERIOD_NS)
    last = preintegrate(gyro, ns(0.25, 1.0), np.zeros(3), PERIOD_NS)
    np.testing.assert_array_equal(last.gap_turn, all_at_once.gap_turn[-1:])


# Noise

def test_integrated_noise_grows_as_the_square_root_of_time():
    """The attitude error of simulated readings has the variance N^2 t, each axis."""
    seconds, runs = 10.0, 150
    scenario = Scenario().replace({
        'simulation.duration_s': seconds, 'gyro.arw_deg_sqrt_h': 0.1, 'motion.dwell_s': 2.0})
    truth = Truth.from_scenario(scenario)
    start = truth.motion.start_ns
    cuts = start + np.array([0, int(4e9), int(10e9)])
    C_ig = truth.motion.attitude(cuts)
    C_gi = np.swapaxes(C_ig, -1, -2)
    errors = []
    for seed in range(runs):
        gyro = GyroSimulator(scenario, truth, np.random.default_rng(seed)).next(1000)
        Delta = preintegrate(gyro, cuts, truth.bias, PERIOD_NS).Delta
        errors.append(rotation.log(Delta @ C_gi[:-1] @ C_ig[1:]))
    N = 0.1 * DEG_PER_SQRT_HOUR
    normalised = np.sum((np.array(errors) / (N * np.sqrt([[4.0], [6.0]])))**2, axis=(0, 2))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * runs)
    assert (low < normalised).all() and (normalised < high).all()
