# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Effects that gyros and stars may show in the turns they saw, and models made of them.

An effect has columns of the design matrix (`design_matrix`), or is a noise whose size is not as
stated. A model is the base, mounting and bias, with the effects that were taken in.
"""

from __future__ import annotations

from typing import NamedTuple

from starcal_ros.checks.chance import beyond_chance
from starcal_ros.checks.likelihood import StatedNoise

# Columns of the design matrix.
PSI, BIAS = tuple(range(3)), tuple(range(3, 6))
TIME, DRIFT = 6, 7
MATRIX = tuple(range(8, 14))
COMMON, STAMP_DRIFT = 14, 15
STEPS = 16
"""Times at which something is thought to step, at once."""
TIME_STEPS = 16
BIAS_STEPS = TIME_STEPS + STEPS
"""The first of them, one for each time, and three for each."""
WIDTH = BIAS_STEPS + 3 * STEPS
MATRIX_NAMES = ('xx', 'yy', 'zz', 'xy', 'xz', 'yz')
BASE = (*PSI, *BIAS)

TIME_OFFSET, CLOCK_DRIFT, TIME_STEP = 'time offset', 'drift of a clock', 'step of a clock'
SCALE, GYRO_MATRIX = 'gyro scale', 'gyro scale and misalignment'
BIAS_STEP = 'step of the bias'
WALK, BIAS_WALK, STAMPS = ('angular random walk', 'random walk of the bias',
                           'scatter of the stamps')
_TRIED = 10_000         # times at which something may step, in all


class Explanation(NamedTuple):
    """An explanation: columns of the comparison, or a noise, and how many were tried for it."""

    name: str
    columns: tuple[int, ...] = ()
    noise: str = ''
    tried: int = 1
    at: int = -1

    @property
    def numbers(self) -> int:
        """How many numbers it has."""
        return len(self.columns) + bool(self.noise)

    @property
    def chance(self) -> float:
        """What it is worth by chance."""
        return beyond_chance(self.numbers, self.tried)


EFFECTS = (
    Explanation(TIME_OFFSET, (TIME,)), Explanation(CLOCK_DRIFT, (TIME, DRIFT)),
    Explanation(CLOCK_DRIFT, (TIME, STAMP_DRIFT)),
    *(Explanation(TIME_STEP, (TIME, TIME_STEPS + k), '', _TRIED, k) for k in range(STEPS)),
    Explanation(SCALE, (COMMON,)), Explanation(GYRO_MATRIX, MATRIX),
    *(Explanation(BIAS_STEP, tuple(range(BIAS_STEPS + 3 * k, BIAS_STEPS + 3 * k + 3)), '',
                  _TRIED, k) for k in range(STEPS)),
    Explanation(WALK, noise='walk'), Explanation(BIAS_WALK, noise='bias_walk'),
    Explanation(STAMPS, noise='stamps'))


class Model(NamedTuple):
    """Effects taken in, and the noise."""

    effects: tuple[Explanation, ...]
    noise: StatedNoise

    @property
    def columns(self) -> tuple[int, ...]:
        """What is fitted: the base, and each effect's columns once."""
        own = {column for effect in self.effects for column in effect.columns}
        return (*BASE, *sorted(own))
