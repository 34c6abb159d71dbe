# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the gyros make of an interval moves with its ends as it is said to."""

from functools import cache

import numpy as np

from instruments import TAN2018
from starcal_ros.checks.turns import Gyro, Running, Turns
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.simulation import sensors

MOVING = TAN2018.replace({'simulation.duration_s': 60.0, 'motion.dwell_s': 1.0,
                          'motion.rate_deg_s': 3.0})


@cache
def readings():
    gyro = sensors.gyro(MOVING)
    return gyro.next(gyro.count)


def intervals(begin_ns, end_ns):
    n = len(begin_ns)
    nothing = np.zeros((n, 3, 3))
    return Turns(begin_ns, end_ns, np.zeros((n, 3)), nothing, nothing, nothing,
                 np.ones(n, bool))


def spread():
    first = int(readings().stamp_ns[0])
    begin_ns = first + np.arange(2, 56) * 10**9 + 3_456_789
    return intervals(begin_ns, begin_ns + 10**9)


def test_a_turn_changes_with_the_times_of_its_ends():
    gyro, turns, h_ns = Gyro(readings()), spread(), 10**6
    g, _ = gyro.turned(turns, lambda stamp: stamp)
    by_begin, by_end = gyro.slopes(turns, lambda stamp: stamp, g)
    for slope, which in ((by_begin, 0), (by_end, 1)):
        # Every other interval, so that no end is that of two.
        for rows in (slice(0, None, 2), slice(1, None, 2)):
            of = turns.take(np.arange(len(turns))[rows])
            moved = [Gyro(readings()).turned(of, lambda stamp, step=sign * h_ns: stamp + step * (
                np.isin(stamp, (of.begin_ns, of.end_ns)[which])))[0] for sign in (1, -1)]
            expected = (moved[0] - moved[1]) / (2e-9 * h_ns)
            # Both are means of the same readings over 2 ms; second order in the turn is left out.
            np.testing.assert_allclose(slope[rows], expected, atol=1e-6)
    assert np.abs(by_end).max() > 0.05


def test_the_same_ends_are_integrated_once(monkeypatch):
    from starcal_ros.measurements import preintegration
    whole, calls = preintegration.preintegrate, []
    monkeypatch.setattr(preintegration, 'preintegrate',
                        lambda *given: calls.append(1) or whole(*given))
    gyro, turns = Gyro(readings()), spread()
    first, again = (gyro.turned(turns, lambda stamp: stamp)[0] for _ in range(2))
    other, _ = gyro.turned(turns, lambda stamp: stamp + 10**8)
    assert len(calls) == 2
    np.testing.assert_array_equal(first, again)
    assert np.abs(other - first).max() > 1e-4


def test_the_running_integral_turns_as_the_readings_do_at_any_lag():
    turns, first = spread(), int(readings().stamp_ns[0])
    running = Running.of(readings())
    for lag_s in (-1.25, 0.0, 0.37):
        g, inside = running.turned(*((stamp - first) * 1e-9 + lag_s
                                     for stamp in (turns.begin_ns, turns.end_ns)))
        exact, _ = Gyro(readings()).turned(
            turns, lambda stamp: stamp + round(lag_s * 1e9))
        assert inside.all()
        np.testing.assert_allclose(g, exact, atol=2e-3 * np.abs(exact).max())


def test_no_interval_is_integrated_over_a_silence():
    kept = np.ones(len(readings()), bool)
    kept[2000:2500] = False                     # 5 s of 60
    running = Running.of(readings().take(kept))
    turns, first = spread(), int(readings().stamp_ns[0])
    begin_s, end_s = ((stamp - first) * 1e-9 for stamp in (turns.begin_ns, turns.end_ns))
    g, inside = running.turned(begin_s, end_s)
    silent = (end_s > 19.99) & (begin_s < 25.0)
    np.testing.assert_array_equal(inside, ~silent)
    exact, _ = Gyro(readings()).turned(turns, lambda stamp: stamp)
    np.testing.assert_allclose(g, exact[inside], atol=2e-3 * np.abs(exact).max())


def test_stamps_that_are_far_apart_take_no_memory():
    stamp_ns = np.arange(50, dtype=np.int64) * 10**15
    assert len(Running.of(GyroSamples(stamp_ns, np.ones((50, 3)))).angle) < 200
