# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The arithmetic of the attitude between frames, compiled: the functions of `track_reference`.

One reading after the other, so that the bits do not depend on how many come at once.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.core.compiled import ready
from starcal_ros.core.compiled_parts import exp, jit as _jit, product
from starcal_ros.core.units import NS
from starcal_ros.filter.track_reference import Attained
from starcal_ros.measurements.preintegration import GAP
from starcal_ros.measurements.samples import GyroSamples


@_jit('void(i8[::1], f8[:,::1], i8, i8, i8, i8, f8, f8[:,::1], f8[::1], f8, f8[::1], f8[:,::1], '
      'f8[:,:,::1], f8[:,::1], f8[:,::1], f8[::1])')
def _integrate(stamp_ns, reading, first, last, at_ns, period_ns, gap_ns, C_gi, turn, gap_turn,
               bias, gain, attitudes, rates, turns, gap_turns):
    C, step, turned = C_gi.copy(), np.empty((3, 3)), np.empty((3, 3))
    total, theta, omega = turn.copy(), np.empty(3), np.empty(3)
    for k in range(min(first, np.searchsorted(stamp_ns, at_ns, side='right')), last):
        begins_ns = before_ns = stamp_ns[k] - period_ns
        if k > 0:
            before_ns = stamp_ns[k - 1]
            if stamp_ns[k] - before_ns <= gap_ns:
                begins_ns = before_ns
        # A silence that is bridged, and what the reading covers.
        for end_ns, silent in ((begins_ns, True), (stamp_ns[k], False)):
            for i in range(3):
                omega[i] = reading[k, i] - bias[i]
                if silent and k > 0:
                    omega[i] = 0.5 * (reading[k - 1, i] + reading[k, i]) - bias[i]
            if end_ns <= at_ns:
                continue
            if silent:
                gap_turn += 0.5 * abs(((end_ns - before_ns) * NS)**2
                                      - ((at_ns - before_ns) * NS)**2)
            for i in range(3):
                theta[i] = (gain[i, 0] * omega[0] + gain[i, 1] * omega[1]
                            + gain[i, 2] * omega[2]) * ((end_ns - at_ns) * NS)
                total[i] += theta[i]
            exp(-theta[0], -theta[1], -theta[2], step)
            product(step, C, turned)
            C[:] = turned
            at_ns = end_ns
        if k >= first:
            attitudes[k - first], turns[k - first], gap_turns[k - first] = C, total, gap_turn
            for i in range(3):
                rates[k - first, i] = (gain[i, 0] * omega[0] + gain[i, 1] * omega[1]
                                       + gain[i, 2] * omega[2])


def integrate(gyro: GyroSamples, first: int, last: int, start: Attained, bias: Array, gain: Array,
              period_ns: float) -> Attained:
    """Do as `track_reference.integrate`."""
    n = last - first
    out = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    _integrate(ready(gyro.stamp_ns), ready(gyro.rate), first, last, start.stamp_ns[0],
               int(period_ns), GAP * period_ns, ready(start.C_gi[0]), start.turn[0],
               start.gap_turn[0], ready(bias), ready(gain), *out)
    return Attained(gyro.stamp_ns[first:last], *out)


@_jit('void(f8[:,::1], f8[:,::1], f8[:,:,::1], f8[::1], f8[::1], f8[:,:,::1])')
def _spread(root, drift, bent, elapsed, variance, out):
    grown = np.empty_like(root)
    columns = root.shape[1]
    for k in range(len(elapsed)):
        for i in range(3):
            for j in range(columns):
                grown[i, j] = root[i, j] + elapsed[k] * drift[i, j] + bent[k, i, j]
        for i in range(3):
            for m in range(i + 1):
                value = variance[k] if i == m else 0.0
                for j in range(columns):
                    value += grown[i, j] * grown[m, j]
                out[k, i, m] = out[k, m, i] = value


def spread(root: Array, drift: Array, bent: Array, elapsed: Array, variance: Array) -> Array:
    """Do as `track_reference.spread`."""
    out = np.empty((len(elapsed), 3, 3))
    _spread(*map(ready, (root, drift, bent, elapsed, variance)), out)
    return out
