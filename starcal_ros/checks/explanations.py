# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which few effects explain what the gyros and the stars say of the same turns.

The model begins with a mounting, a bias and the stated noise. Of all other effects that is taken
in which makes the data most likely for its numbers (`likelihood`), as long as chance would not
do as much; then each that is no longer needed is left out. So a scale factor is not found where a
time offset explains the same, and where two do as well, which is said, neither is believed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from starcal_ros.checks.chance import beyond_chance
from starcal_ros.checks.likelihood import WAVES, Comparison, EffectSizes, StatedNoise
from starcal_ros.checks.turns import Gyro, Turns
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import NS

PSI, BIAS = tuple(range(3)), tuple(range(3, 6))
TIME, DRIFT = 6, 7
MATRIX = tuple(range(8, 14))
COMMON, STAMP_DRIFT = 14, 15
STEPS = 16              # times at which something is thought to step, at once
_TIME_STEP = 16
_BIAS_STEP = _TIME_STEP + STEPS
_WIDTH = _BIAS_STEP + 3 * STEPS
MATRIX_NAMES = ('xx', 'yy', 'zz', 'xy', 'xz', 'yz')
BASE = (*PSI, *BIAS)
_PRIOR = np.full(_WIDTH, np.inf)
_PRIOR[list(PSI)], _PRIOR[[*MATRIX, COMMON]] = 0.1, 0.05
"""What the motion does not show stays where it is."""

TIME_OFFSET, CLOCK_DRIFT, TIME_STEP = 'time offset', 'drift of a clock', 'step of a clock'
SCALE, GYRO_MATRIX = 'gyro scale', 'gyro scale and misalignment'
BIAS_STEP = 'step of the bias'
WALK, BIAS_WALK, STAMPS = ('angular random walk', 'random walk of the bias',
                           'scatter of the stamps')
AMBIGUOUS = 12.0        # twice the logarithm of a likelihood ratio, about 400 to 1

_KIN = {TIME_OFFSET: (CLOCK_DRIFT, TIME_STEP), CLOCK_DRIFT: (TIME_OFFSET,),
        TIME_STEP: (TIME_OFFSET,), SCALE: (GYRO_MATRIX,), GYRO_MATRIX: (SCALE,)}
"""Explanations that hold each other, and are no rivals."""
_LINEAR_ROUNDS = 4
_TRIED = 10_000         # times at which something may step, in all
_EVEN = STEPS // 2      # of the times, evenly spread; the others are where the turns fit least
_MOST = 6               # effects that are taken in
_REACH = {WALK: (1e-2, 1e4), BIAS_WALK: (1e-5, 1e4), STAMPS: (1e-5, 1.0)}
_GRID = 13


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
    *(Explanation(TIME_STEP, (TIME, _TIME_STEP + k), '', _TRIED, k) for k in range(STEPS)),
    Explanation(SCALE, (COMMON,)), Explanation(GYRO_MATRIX, MATRIX),
    *(Explanation(BIAS_STEP, tuple(range(_BIAS_STEP + 3 * k, _BIAS_STEP + 3 * k + 3)), '',
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


class Explained(NamedTuple):
    """An effect that is needed.

    Attributes
    ----------
    effect : Explanation
    value, sigma : (k,) array
        Of its own columns, or of its noise, the latter two None for the second.
    gain : float
        Twice the logarithm of the likelihood ratio that it is worth.
    rival : str
        What would have done nearly as well in its place, or nothing.
    rival_gain : float
    """

    effect: Explanation
    value: Array
    sigma: Array
    gain: float
    rival: str
    rival_gain: float

    @property
    def ambiguous(self) -> bool:
        """Whether another explanation does as well."""
        return self.gain - self.rival_gain < AMBIGUOUS


@dataclass(frozen=True)
class TurnModel:
    """What explains the turns.

    Attributes
    ----------
    C_sg : (3, 3) array
        Mounting that fits.
    psi_sigma : (3,) array
        Of its angles, in s [rad].
    bias, bias_sigma : (3,) array
        [rad/s].
    explained : tuple of Explained
    step_s : mapping
        Times that were tried for each kind of step, (STEPS,) [s from the first frame on].
    resolved_s : float
        Shortest time, over which a bias that walks is followed [s].
    """

    C_sg: Array
    psi_sigma: Array
    bias: Array
    bias_sigma: Array
    explained: tuple[Explained, ...]
    step_s: Mapping[str, Array]
    resolved_s: float


class _Rows(NamedTuple):
    """The first intervals after the steps that are tried, (STEPS,) of each kind.

    A clock that steps while the camera turns shows it in one interval most of all: there the
    turns fit least, and times are tried there as well as evenly spread ones.
    """

    time: Ints
    bias: Ints
    time_apart: int
    bias_apart: int

    @classmethod
    def over(cls, n: int) -> _Rows:
        """Return rows over all of n intervals."""
        return cls(_spread(0, n, STEPS), _spread(0, n, STEPS), n // _EVEN, n // STEPS)

    def with_outliers(self, rows: Ints) -> _Rows:
        """Return the same with other rows in place of half of those of the clock."""
        n = int(self.time[-1]) + self.bias_apart
        time = np.concatenate((_spread(0, n, STEPS - len(rows)), rows))
        return self._replace(time=time)

    def closer(self, model: Model) -> _Rows | None:
        """Return rows about those of the model, closer to each other; None if they are close."""
        found = self
        for effect in model.effects:
            if effect.name == TIME_STEP and self.time_apart > 1:
                even, apart = _about(int(self.time[effect.at]), self.time_apart, _EVEN)
                found = found._replace(time=np.concatenate((even, self.time[_EVEN:])),
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


def explain(turns: Turns, gyro: Gyro, C_sg: Array, bias: Array, lag_s: float, stated: StatedNoise
            ) -> TurnModel:
    """Find what explains the turns beyond a mounting and a bias near those given.

    Parameters
    ----------
    turns : Turns
        By the stars, covered by the readings.
    gyro : Gyro
        Readings in rad/s.
    C_sg : (3, 3) array
        Mounting to begin with.
    bias : (3,) array
        Bias to begin with [rad/s].
    lag_s : float
        Time offset to begin with [s].
    stated : StatedNoise
        As stated.
    """
    at = np.zeros(_WIDTH)
    at[TIME], at[list(BIAS)] = lag_s, bias
    rows = _Rows.over(len(turns))
    comparison = _linear(turns, gyro, C_sg, at, rows)
    for _ in range(_LINEAR_ROUNDS):
        walk = _best_noise(comparison, Model((EFFECTS[0],), stated), 'walk')[1]
        columns = [*BASE, TIME, DRIFT, COMMON]      # what would be taken for a drift, too
        fit = comparison.fit(columns, walk)
        seen = np.abs(fit.beta[6:8]) > 8.0 * np.sqrt(np.diag(fit.covariance))[6:8]
        seen |= at[[TIME, DRIFT]] != 0.0
        C_sg = rotation.exp(fit.beta[:3]) @ C_sg
        at[list(BIAS)] = fit.beta[3:6]
        moved = np.where(seen, fit.beta[6:8], 0.0)
        settled = np.abs(moved[0] - at[TIME]) < 1e-4
        at[[TIME, DRIFT]] = moved
        comparison = _linear(turns, gyro, C_sg, at, rows)
        if settled:
            break
    rows = rows.with_outliers(comparison.outliers((*BASE, TIME), walk, STEPS - _EVEN))
    comparison = _linear(turns, gyro, C_sg, at, rows)
    model = _selected(comparison, stated)
    while (closer := rows.closer(model)) is not None:
        rows = closer
        comparison = _linear(turns, gyro, C_sg, at, rows)
        model = _selected(comparison, stated)
    for _ in range(_LINEAR_ROUNDS // 2):
        if TIME_STEP not in {effect.name for effect in model.effects}:
            break
        # Half of a step is far from where the stamps were: linear about the step itself.
        at[[TIME, DRIFT]] = 0.0
        at[_TIME_STEP:_BIAS_STEP] = 0.0
        moved = np.intersect1d(model.columns, [TIME, DRIFT, *range(_TIME_STEP, _BIAS_STEP)])
        fit = comparison.fit(model.columns, model.noise)
        at[moved] = fit.beta[np.searchsorted(model.columns, moved)]
        comparison = _linear(turns, gyro, C_sg, at, rows)
        model = _selected(comparison, stated)
    fit = comparison.fit(model.columns, model.noise)
    sigma = np.sqrt(np.diag(fit.covariance))
    since = (turns.end_ns - turns.end_ns[0]) * 1e-9
    return TurnModel(
        rotation.exp(fit.beta[:3]) @ C_sg, sigma[:3], fit.beta[3:6], sigma[3:6],
        tuple(_explained(comparison, model, fit, stated)),
        {TIME_STEP: since[rows.time], BIAS_STEP: since[rows.bias]},
        float(since[-1]) / (np.pi * WAVES))


def _linear(turns: Turns, gyro: Gyro, C_sg: Array, at: Array, rows: _Rows) -> Comparison:
    """Return the comparison, linear about some sizes of the effects, as if these were zero.

    All columns but those of the mounting are whole sizes: what `at` has of them is added back.
    """
    middle = int((turns.begin_ns[0] + turns.end_ns[-1]) // 2)

    # A step in a pause is before the whole interval that follows.
    stepped = [((turns.end_ns if turns.chained[row] else turns.begin_ns)[row], at[_TIME_STEP + k])
               for k, row in enumerate(rows.time) if at[_TIME_STEP + k]]

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
    X = np.zeros((len(turns), 3, _WIDTH))
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
        X[row:, :, _TIME_STEP + k] = by_time[row:]
        X[row, :, _TIME_STEP + k] = (by_end if turns.chained[row] else by_time)[row]
    for k, row in enumerate(rows.bias):
        after = slice(row, None)
        X[after, :, _BIAS_STEP + 3 * k:_BIAS_STEP + 3 * k + 3] = bias_turn[after]
    y = turns.r - r + X @ at
    return Comparison(turns, y, X, bias_turn, _PRIOR)


def _cost(comparison: Comparison, model: Model) -> float:
    return comparison.fit(model.columns, model.noise).minus_2_log


def _best_noise(comparison: Comparison, model: Model, kind: str) -> tuple[float, StatedNoise]:
    """Return the least cost for any size of one noise, and the noise."""
    from scipy.optimize import minimize_scalar
    stated = model.noise
    unit = 1.0 if kind == 'stamps' else max(stated.walk, 1e-9)
    name = {'walk': WALK, 'bias_walk': BIAS_WALK, 'stamps': STAMPS}[kind]
    low, high = (np.log(part * unit) for part in _REACH[name])

    def cost(log_size: float) -> float:
        noise = stated._replace(**{kind: float(np.exp(log_size))})
        return _cost(comparison, model._replace(noise=noise))

    grid = np.linspace(low, high, _GRID)
    k = int(np.argmin([cost(each) for each in grid]))
    found = minimize_scalar(cost, bounds=(grid[max(k - 1, 0)], grid[min(k + 1, _GRID - 1)]),
                            method='bounded', options={'xatol': 0.02})
    return float(found.fun), stated._replace(**{kind: float(np.exp(found.x))})


def _with(comparison: Comparison, model: Model, effect: Explanation) -> tuple[float, Model]:
    """Return the cost and the model with one more effect."""
    more = model._replace(effects=(*model.effects, effect))
    if effect.noise:
        cost, noise = _best_noise(comparison, more, effect.noise)
        return cost, more._replace(noise=noise)
    return _cost(comparison, more), more


def _selected(comparison: Comparison, stated: StatedNoise) -> Model:
    """Take effects in, the one that is worth most first, and leave out what is not needed."""
    model = Model((), stated)
    for _ in range(_MOST):
        now = _cost(comparison, model)
        best, chosen = 0.0, model
        for effect in EFFECTS:
            if effect.name in {each.name for each in model.effects}:
                continue
            cost, more = _with(comparison, model, effect)
            fresh = len(set(more.columns) - set(model.columns)) + bool(effect.noise)
            worth = now - cost - beyond_chance(max(fresh, 1), effect.tried)
            if fresh and worth > best:
                best, chosen = worth, more
        if chosen is model:
            break
        model = _pruned(comparison, _settled(comparison, chosen), stated)
    return model


def _settled(comparison: Comparison, model: Model) -> Model:
    """Fit the noises again, beside the effects that are now there."""
    for effect in model.effects:
        if effect.noise:
            model = model._replace(noise=_best_noise(comparison, model, effect.noise)[1])
    return model


def _without(comparison: Comparison, model: Model, effect: Explanation, stated: StatedNoise
             ) -> Model:
    effects = tuple(each for each in model.effects if each is not effect)
    noise = model.noise
    if effect.noise:
        noise = noise._replace(**{effect.noise: getattr(stated, effect.noise)})
    return _settled(comparison, Model(effects, noise))


def _pruned(comparison: Comparison, model: Model, stated: StatedNoise) -> Model:
    for effect in model.effects:
        less = _without(comparison, model, effect, stated)
        fresh = len(model.columns) - len(less.columns) + bool(effect.noise)
        if _cost(comparison, less) - _cost(comparison, model) < beyond_chance(
                max(fresh, 1), effect.tried):
            model = less
    return model


def _explained(comparison: Comparison, model: Model, fit: EffectSizes, stated: StatedNoise
               ) -> list[Explained]:
    """Return each effect with its sizes, what it is worth, and what else would do."""
    found = []
    now, sigma = fit.minus_2_log, np.sqrt(np.diag(fit.covariance))
    for effect in model.effects:
        less = _without(comparison, model, effect, stated)
        base = _cost(comparison, less)
        rivals = [(base - _with(comparison, less, other)[0], other) for other in EFFECTS
                  if other.name not in {each.name for each in model.effects}
                  and other.name not in _KIN.get(effect.name, ())]
        rival_gain, rival = max(rivals, key=lambda each: each[0] - each[1].chance)
        if effect.noise:
            value = np.array([getattr(model.noise, effect.noise)])
            spread = np.array([_noise_sigma(comparison, model, effect.noise, now)])
        else:
            rows = [model.columns.index(column) for column in effect.columns]
            value, spread = fit.beta[rows], sigma[rows]
        found.append(Explained(effect, value, spread, base - now, rival.name, rival_gain))
    return found


def _noise_sigma(comparison: Comparison, model: Model, kind: str, now: float) -> float:
    """Return the sigma of a noise by the curvature of its likelihood over the logarithm."""
    size, h = float(getattr(model.noise, kind)), 0.1
    up, down = (_cost(comparison, model._replace(noise=model.noise._replace(
        **{kind: size * float(np.exp(step))}))) for step in (h, -h))
    curvature = max((up + down - 2.0 * now) / h**2, 1e-6)
    return size * float(np.sqrt(2.0 / curvature))
