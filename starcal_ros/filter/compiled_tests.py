# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether anything speaks against the model, compiled: what is asked where a candidate begins.

The same as `ModelTests` answers in words, to rounding, but without them: numbers are held against
probabilities, not against the quantiles that a user is told. A chi-square number of at most three
degrees of freedom is beyond chance with a probability in closed form (Abramowitz and Stegun,
26.4.4 and 26.4.5).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.core.compiled_parts import jit as _jit
from starcal_ros.core.statistic import ALARM, MARGIN
from starcal_ros.filter.allowances import (DISPLACED, HARM, LEAST_OF_BIN, LEAST_OF_STAR, LOSSES,
                                           LOSSES_FRAMES, REJECTED, SCATTER, WINDOW)
from starcal_ros.filter.changes import (AFRESH, BEGUN, CLEAN, COUNTED, SINCE, SLOTS, START, STRIDE,
                                        TOLD)
from starcal_ros.filter.frame_innovation import (ALONG, E as _MEAN, FRAMES, FREEDOM, LAG, PAIRS,
                                                 RATE, REST, SUMS, TURN)
from starcal_ros.filter.hypotheses import CELL, CHANGING, DRIFTS, HYPOTHESES, STEPS
from starcal_ros.filter.responses import WIDTH

_FIRST, _STATES = len(HYPOTHESES), len(CHANGING)        # of the candidates, and in each
_CELL, _CELLS = CELL.start, CELL.stop - CELL.start
_DRIFT, _DRIFTS_END = DRIFTS.start, DRIFTS.stop
_E = _MEAN.start
_STEPS = STEPS.copy()


@_jit
def _chance(value: float, freedom: int) -> float:
    """Return the probability with which a chi-square number is more than a value, 0 at least."""
    half = 0.5 * value
    if freedom == 2:
        return math.exp(-half)
    more = math.erfc(math.sqrt(half))
    return more + 2.0 * math.sqrt(half / math.pi) * math.exp(-half) if freedom == 3 else more


@_jit
def _usual(deviate: float, tried: int) -> bool:
    """Tell whether the worst of some normal numbers, of both signs, may be so by chance."""
    return math.erfc(abs(deviate) * math.sqrt(0.5)) >= ALARM / tried


@_jit
def _deviate(value: float, freedom: float) -> float:
    """As that of `innovation_tests`."""
    part = 2.0 / (9.0 * freedom)
    return ((max(value, 0.0) / freedom)**(1.0 / 3.0) - 1.0 + part) / math.sqrt(part)


@_jit
def _beside(value: float, freedom: float, margin: float) -> float:
    """Return the deviate of a chi-square number from its margin, 0 inside."""
    return max(_deviate(value / margin, freedom), 0.0) + min(
        _deviate(value * margin, freedom), 0.0)


@_jit
def _even(number: Any, squares: Array, gated: float) -> bool:
    """Tell whether the stars of each kind scatter as stated."""
    worst, kinds = 0.0, 0
    for k in range(len(number)):
        if number[k] >= LEAST_OF_BIN:
            kinds += 1
            worst = max(worst, abs(_beside(squares[k] / gated, 2.0 * number[k], SCATTER)))
    return kinds == 0 or _usual(worst, kinds)


@_jit
def as_expected(run, worst, seen, gated, star_frames, star_sums, cell_count, cell_squares,
                magnitude_count, magnitude_squares):
    """Tell whether there is a window at least, and all of `InnovationTests.statistics` pass."""
    n, freedom, pairs = run[FRAMES], run[FREEDOM], run[PAIRS]
    if n < WINDOW:
        return False
    if not (_usual(_beside(run[TURN], 3.0 * n, MARGIN), 1)
            and _usual(_beside(run[REST] / gated, freedom, MARGIN), 1)):
        return False
    square = 0.0
    for k in range(_E, SUMS):
        square += run[k] * run[k]
    lag = run[LAG] / math.sqrt(3.0 * pairs) if pairs else run[LAG]
    along = run[ALONG] / math.sqrt(run[RATE]) if run[RATE] else run[ALONG]
    if not (_chance(square / n, 3) >= ALARM and _usual(lag, 1) and _usual(along, 1)):
        return False
    for k in range(2 if worst[2] else 0):
        if not _usual(worst[k], worst[2]):
            return False
    furthest, often = 0.0, 0
    for row in range(len(star_frames)):
        if star_frames[row] >= LEAST_OF_STAR:
            often += 1
            root = math.sqrt(star_frames[row])
            for i in range(2):
                furthest = max(furthest, abs(star_sums[row, i]) / root - DISPLACED * root)
    if often and not _usual(furthest, 2 * often):
        return False
    return (seen[1] <= REJECTED * max(seen[0] + seen[1], 1)
            and seen[2] <= LOSSES + n / LOSSES_FRAMES
            and _even(cell_count, cell_squares, gated)
            and _even(magnitude_count, magnitude_squares, gated))


@_jit
def harmless(E, root, p, gain, freedom, begun):
    """Tell whether no effect that `effect_tests` would tell of is beyond chance and does harm."""
    n, effects = len(root), len(gain)
    sigma, counted = np.empty(n), np.empty(effects)
    for i in range(n):
        square = 0.0
        for k in range(n):
            square += root[i, k] * root[i, k]
        sigma[i] = max(math.sqrt(square), 1e-300)
    for g in range(effects):
        harm = 0.0
        for i in range(n):
            shifted = (E[i, WIDTH * g] * p[g, 0] + E[i, WIDTH * g + 1] * p[g, 1]
                       + E[i, WIDTH * g + 2] * p[g, 2])
            harm = max(harm, abs(shifted) / sigma[i])
        counted[g] = gain[g] * max(1.0 - HARM / max(harm, 1e-300), 0.0)**2
    for g in range(_CELL):
        if freedom[g] and not _chance(counted[g] / MARGIN, freedom[g]) >= ALARM:
            return False
    g = _CELL
    for cell in range(_CELL, _CELL + _CELLS):
        if counted[cell] > counted[g]:
            g = cell
    if freedom[g] and not _chance(counted[g] / MARGIN, freedom[g]) >= ALARM / _CELLS:
        return False
    for state in range(_STATES):
        g = _FIRST + state
        for slot in range(1, SLOTS):
            if counted[_FIRST + slot * _STATES + state] > counted[g]:
                g = _FIRST + slot * _STATES + state
        if freedom[g] and not _chance(counted[g] / MARGIN, freedom[g]) >= (
                ALARM / (_STATES * max(begun, 1))):
            return False
    return True


@_jit
def stands_out(gain, freedom, slots, counts):
    """Tell whether `Changes.find` may see a step or a drift."""
    best = _FIRST
    for g in range(_FIRST, _FIRST + _STATES * min(counts[BEGUN], SLOTS)):
        if gain[g] > gain[best]:
            best = g
    drift, steady = _DRIFT, 0.0
    for g in range(_FIRST):
        if _DRIFT <= g < _DRIFTS_END:
            if gain[g] > gain[drift]:
                drift = g
        else:
            steady = max(steady, gain[g])
    if counts[BEGUN] == 0:
        return False
    if (gain[best] > max(steady, gain[drift]) + TOLD and slots[(best - _FIRST) // _STATES, CLEAN]
            and _chance(gain[best], max(freedom[best], 1)) < ALARM / (_STATES * counts[BEGUN])):
        return True
    return (gain[drift] > max(steady, gain[best]) + TOLD
            and _chance(gain[drift], max(freedom[drift], 1)) < ALARM / _STATES)


@_jit
def due(stamp_ns, counts):
    """As `Changes.due`."""
    if counts[COUNTED] == 0:
        counts[SINCE] = stamp_ns
    counts[COUNTED] += 1
    return counts[COUNTED] > 1 and counts[COUNTED] % STRIDE == 1


@_jit
def begin(stamp_ns, clean, slots, counts, E, s, information):
    """As `Changes.begin`."""
    slot = counts[BEGUN]
    if slot >= SLOTS:
        starts = slots[:, START].astype(np.float64)
        order = np.argsort(starts)
        slot, least = 0, np.inf
        for k in range(1, SLOTS - 1):
            between = (starts[order[k + 1]] - starts[order[k - 1]]) / (
                stamp_ns - starts[order[k]])
            if between < least:
                slot, least = order[k], between
    slots[slot, START], slots[slot, CLEAN], slots[slot, AFRESH] = stamp_ns, clean, False
    counts[BEGUN] += 1
    for state in range(_STATES):
        effect = _FIRST + slot * _STATES + state
        for a in range(WIDTH):
            s[effect, a] = 0.0
            for i in range(len(E)):
                E[i, WIDTH * effect + a] = -_STEPS[state, i, a]
            for b in range(WIDTH):
                information[effect, a, b] = 0.0
