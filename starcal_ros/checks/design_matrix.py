# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Turns by the gyros less those by the stars, linear in the sizes of all effects.

Steps of a clock and of the bias are tried at `STEPS` times, which close in on where they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.checks.effects import (BIAS, BIAS_STEP, BIAS_STEPS, COMMON, DRIFT, MATRIX, PSI,
                                        STAMP_DRIFT, STEPS, TIME, TIME_STEP, TIME_STEPS, WIDTH,
                                        Model)
from starcal_ros.checks.likelihood import Comparison
from starcal_ros.checks.turns import Gyro, Turns
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import NS

_PRIOR = np.full(WIDTH, np.inf)
_PRIOR[list(PSI)], _PRIOR[[*MATRIX, COMMON]] = 0.1, 0.05
"""What the motion does not show stays where it is."""
EVEN = STEPS // 2
"""Of the times of a clock, evenly spread; the others are where the turns fit least."""


class StepRows(NamedTuple):
    """The first intervals after the steps that are tried, (STEPS,) of each kind.

    A clock that steps while the camera turns shows it in one interval most of all: there the
    turns fit least, and times are tried there as well as evenly spread ones.
    """

    time: Ints
    bias: Ints
    time_apart: int
    bias_apart: int

    @classmethod
    def over(cls, n: int) -> StepRows:
        """Return rows over all of n intervals."""
        return cls(_spread(0, n, STEPS), _spread(0, n, STEPS), n // EVEN, n // STEPS)

    def with_outliers(self, rows: Ints) -> StepRows:
        """Return the same with other rows in place of half of those of the clock."""
        n = int(self.time[-1]) + self.bias_apart
        time = np.concatenate((_spread(0, n, STEPS - len(rows)), rows))
        return self._replace(time=time)

    def closer(self, model: Model) -> StepRows | None:
        """Return rows about those of the model, closer to each other; None if they are close."""
        found = self
        for effect in model.effects:
            if effect.name == TIME_STEP and self.time_apart > 1:
                even, apart = _about(int(self.time[effect.at]), self.time_apart, EVEN)
                found = found._replace(time=np.concatenate((even, self.time[EVEN:])),
                                       time_apart=apart)
            if effect.name == BIAS_STEP and self.bias_apart > 1:
                even, apart = _about(int(self.bias[effect.at]), self.bias_apart, STEPS)
                found = found._replace(bias=even, bias_apart=apart)
        return None if found is self else found


def _spread(low: int, high: int, count: int) -> Ints:
    return np.linspace(low, high, count + 2)[1:-1].round().astype(np.int64)


def _about(row: int, apart: int, count: int) -> tuple[Ints, int]:
    """Return rows about one of rows so far apart, and how far apart they are."""
    closer = max(2 * apart // (count + 1), 1)
    return np.maximum(row + closer * (np.arange(count) - count // 2), 1), closer


def linearized(turns: Turns, gyro: Gyro, C_sg: Array, at: Array, rows: StepRows) -> Comparison:
    """Return the comparison, linear about some sizes of the effects, as if these were zero.

    All columns but those of the mounting are whole sizes: what `at` has of them is added back.
    """
    middle = int((turns.begin_ns[0] + turns.end_ns[-1]) // 2)

    # A step in a pause is before the whole interval that follows.
    stepped = [((turns.end_ns if turns.chained[row] else turns.begin_ns)[row], at[TIME_STEPS + k])
               for k, row in enumerate(rows.time) if at[TIME_STEPS + k]]

    def warp(stamp: Ints) -> Ints:
        moved = at[TIME] * 1e9 + at[DRIFT] * (stamp - middle)
        for since_ns, size in stepped:
            moved = moved + 1e9 * size * (stamp >= since_ns)
        return stamp + np.rint(moved).astype(np.int64)

    g, J = gyro.turned(turns, warp)
    by_begin, by_end = (slope @ C_sg.T for slope in gyro.slopes(turns, warp, g))
    begin_s, end_s = ((stamp - middle)[:, None] * NS for stamp in (turns.begin_ns, turns.end_ns))
    by_time, by_drift = by_begin + by_end, by_begin * begin_s + by_end * end_s
    r = (g + (J @ at[list(BIAS)])) @ C_sg.T
    omega = g + (J @ at[list(BIAS)])
    bias_turn = C_sg @ J
    X = np.zeros((len(turns), 3, WIDTH))
    X[..., PSI] = -rotation.skew(r)
    X[..., BIAS] = bias_turn
    X[..., TIME], X[..., DRIFT] = by_time, by_drift
    # Readings (I + M) omega: the turn is less by M times itself.
    for column, (i, j) in zip(MATRIX, ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        M = np.zeros((3, 3))
        M[i, j] = M[j, i] = 1.0
        X[..., column] = -omega @ M.T @ C_sg.T
    X[..., COMMON] = -r
    # Where the stamps drift and the readings do not, their integral is too long by as much.
    X[..., STAMP_DRIFT] = by_drift - r
    for k, row in enumerate(rows.time):
        X[row:, :, TIME_STEPS + k] = by_time[row:]
        X[row, :, TIME_STEPS + k] = (by_end if turns.chained[row] else by_time)[row]
    for k, row in enumerate(rows.bias):
        after = slice(row, None)
        X[after, :, BIAS_STEPS + 3 * k:BIAS_STEPS + 3 * k + 3] = bias_turn[after]
    y = turns.r - r + X @ at
    return Comparison(turns, y, X, bias_turn, _PRIOR)
