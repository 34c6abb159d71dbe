# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which effects a model needs: stepwise selection by likelihood.

Of all effects that one is taken in which is worth most for its numbers, as long as chance would
not do as much; then each that is no longer needed is left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.checks.chance import beyond_chance
from starcal_ros.checks.effects import (BIAS_WALK, CLOCK_DRIFT, EFFECTS, GYRO_MATRIX, SCALE,
                                        STAMPS, TIME_OFFSET, TIME_STEP, WALK, Explanation, Model)
from starcal_ros.checks.likelihood import Comparison, EffectSizes, StatedNoise
from starcal_ros.core.arrays import Array

AMBIGUOUS = 12.0
"""Twice the logarithm of a likelihood ratio below which two do as well: about 400 to 1."""

_KIN = {TIME_OFFSET: (CLOCK_DRIFT, TIME_STEP), CLOCK_DRIFT: (TIME_OFFSET,),
        TIME_STEP: (TIME_OFFSET,), SCALE: (GYRO_MATRIX,), GYRO_MATRIX: (SCALE,)}
"""Explanations that hold each other, and are no rivals."""
_MOST = 6               # effects that are taken in
_REACH = {WALK: (1e-2, 1e4), BIAS_WALK: (1e-5, 1e4), STAMPS: (1e-5, 1.0)}
_GRID = 13


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


def _cost(comparison: Comparison, model: Model) -> float:
    return comparison.fit(model.columns, model.noise).minus_2_log


def best_noise(comparison: Comparison, model: Model, kind: str) -> tuple[float, StatedNoise]:
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
        cost, noise = best_noise(comparison, more, effect.noise)
        return cost, more._replace(noise=noise)
    return _cost(comparison, more), more


def selected(comparison: Comparison, stated: StatedNoise) -> Model:
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
            model = model._replace(noise=best_noise(comparison, model, effect.noise)[1])
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


def explained(comparison: Comparison, model: Model, fit: EffectSizes, stated: StatedNoise
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
