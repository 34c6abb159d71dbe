# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which few effects explain what the gyros and the stars say of the same turns.

The model begins with a mounting, a bias and the stated noise, and takes in what makes the data
more likely than chance would (`model_selection`). So a scale factor is not found where a time
offset explains the same, and where two do as well, which is said, neither is believed. The
comparison is linear (`design_matrix`): it is made again about what was found.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from starcal_ros.checks.design_matrix import EVEN, StepRows, linearized
from starcal_ros.checks.effects import (BASE, BIAS, BIAS_STEP, BIAS_STEPS, COMMON, DRIFT, EFFECTS,
                                        STEPS, TIME, TIME_STEP, TIME_STEPS, WIDTH, Model)
from starcal_ros.checks.likelihood import WAVES, StatedNoise
from starcal_ros.checks.model_selection import Explained, best_noise, explained, selected
from starcal_ros.checks.turns import Gyro, Turns
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array

_LINEAR_ROUNDS = 4


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
    at = np.zeros(WIDTH)
    at[TIME], at[list(BIAS)] = lag_s, bias
    rows = StepRows.over(len(turns))
    comparison = linearized(turns, gyro, C_sg, at, rows)
    for _ in range(_LINEAR_ROUNDS):
        walk = best_noise(comparison, Model((EFFECTS[0],), stated), 'walk')[1]
        columns = [*BASE, TIME, DRIFT, COMMON]      # what would be taken for a drift, too
        fit = comparison.fit(columns, walk)
        seen = np.abs(fit.beta[6:8]) > 8.0 * np.sqrt(np.diag(fit.covariance))[6:8]
        seen |= at[[TIME, DRIFT]] != 0.0
        C_sg = rotation.exp(fit.beta[:3]) @ C_sg
        at[list(BIAS)] = fit.beta[3:6]
        moved = np.where(seen, fit.beta[6:8], 0.0)
        settled = np.abs(moved[0] - at[TIME]) < 1e-4
        at[[TIME, DRIFT]] = moved
        comparison = linearized(turns, gyro, C_sg, at, rows)
        if settled:
            break
    rows = rows.with_outliers(comparison.outliers((*BASE, TIME), walk, STEPS - EVEN))
    comparison = linearized(turns, gyro, C_sg, at, rows)
    model = selected(comparison, stated)
    while (closer := rows.closer(model)) is not None:
        rows = closer
        comparison = linearized(turns, gyro, C_sg, at, rows)
        model = selected(comparison, stated)
    for _ in range(_LINEAR_ROUNDS // 2):
        if TIME_STEP not in {effect.name for effect in model.effects}:
            break
        # Half of a step is far from where the stamps were: linear about the step itself.
        at[[TIME, DRIFT]] = 0.0
        at[TIME_STEPS:BIAS_STEPS] = 0.0
        moved = np.intersect1d(model.columns, [TIME, DRIFT, *range(TIME_STEPS, BIAS_STEPS)])
        fit = comparison.fit(model.columns, model.noise)
        at[moved] = fit.beta[np.searchsorted(model.columns, moved)]
        comparison = linearized(turns, gyro, C_sg, at, rows)
        model = selected(comparison, stated)
    fit = comparison.fit(model.columns, model.noise)
    sigma = np.sqrt(np.diag(fit.covariance))
    since = (turns.end_ns - turns.end_ns[0]) * 1e-9
    return TurnModel(
        rotation.exp(fit.beta[:3]) @ C_sg, sigma[:3], fit.beta[3:6], sigma[3:6],
        tuple(explained(comparison, model, fit, stated)),
        {TIME_STEP: since[rows.time], BIAS_STEP: since[rows.bias]},
        float(since[-1]) / (np.pi * WAVES))
