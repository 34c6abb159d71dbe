# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs of W19's simulation, summed up as its tables are: errors, criteria A and B, time."""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import numpy as np

from starcal_ros.calibration import attitude_free
from starcal_ros.calibration.attitude_free import CameraBelief, Measurement
from starcal_ros.calibration.methods.singular_value import MIN_STARS
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.evaluation import consistency
from starcal_ros.measurements.samples import Stars
from starcal_ros.reproduction import wu2019
from starcal_ros.reproduction.wu2019 import LENS, TRUTH, Group, Sky

Row = tuple[str | float, ...]

HEAD = ('case', 'quantity', 'unit', 'paper', 'published', 'full', 'bound', 'ratio')
"""Paper's number; ours with the published weighting and with the full one; bound; full / bound."""

PARAMETERS = ('s', 'f', 'u0', 'v0', 'k1', 'k2')
UNITS = {**dict.fromkeys(PARAMETERS, '%'), 'A': '"', 'A over frames': '"', 'A over runs': '"',
         'B': '"', 'B over frames': '"', 'NEES': '', 'time': 'ms'}
"""Of each quantity; A and B are means, what they are over is a standard deviation, and the time is
that of the median frame."""

_DRAWS = 100
_TIMED, _TRIES = 50, 9


def notes(runs: int) -> tuple[str, ...]:
    """Return what the columns mean, and what the paper does not state."""
    ratio = consistency.rms_interval(runs, 0.95)
    nees = consistency.mean_interval(len(TRUTH), runs, 0.95)
    return (
        'published, full: RMS error of the parameters over the runs, means of all else; the paper '
        'has one run. published weighs each residual as if it were independent, full by the '
        'covariance of all residuals of a frame. bound: Cramér-Rao, the attitude of each frame '
        'unknown; of A what errors drawn from it give.',
        f'Chance alone lets the ratio of a parameter be {ratio.low:.2f} to {ratio.high:.2f} and '
        f'NEES {nees.low:.1f} to {nees.high:.1f}, with 95 % probability in {runs} runs.',
        'W19 states neither attitudes nor initial covariance nor process noise nor the numbering '
        'of the stars. Ours: random, wide, none, by Hipparcos number; Hp limits that show as many '
        'stars a frame as the paper had (limits of 6, 5.5 and 4.6 show 24.5, 14.1 and 5.1).')


class Result(NamedTuple):
    """What the runs of one method gave.

    Attributes
    ----------
    error : (runs, 6) array
        Of W19's parameters.
    A, B : (runs, frames) array
        Criteria of the frames to judge by ["].
    nees : (runs,) array
        Normalised estimation error squared, 6 degrees of freedom.
    """

    error: Array
    A: Array
    B: Array
    nees: Array

    def quantities(self) -> dict[str, float]:
        """Return all of UNITS but the time."""
        percent = 100.0 * np.sqrt(np.mean(self.error**2, axis=0)) / np.abs(TRUTH)
        return {**dict(zip(PARAMETERS, percent.tolist())),
                'A': float(self.A.mean()), 'A over frames': float(self.A.std(axis=-1).mean()),
                'A over runs': float(self.A.mean(axis=-1).std()),
                'B': float(self.B.mean()), 'B over frames': float(self.B.std(axis=-1).mean()),
                'NEES': float(self.nees.mean())}


class Study:
    """The data set of a group, and what methods make of it.

    Parameters
    ----------
    scenario : Scenario
        Its seed, and its length where that is shorter than W19's.
    group : Group
    runs : int
        Draws of the noise.
    sigma_px : float
        Noise of a centroid.
    """

    def __init__(self, scenario: Scenario, group: Group, runs: int,
                 sigma_px: float = wu2019.SIGMA_PX) -> None:
        self.sky: Sky = wu2019.sky(scenario, group)
        self.sigma_px = sigma_px
        seed = scenario.simulation.seed
        self.calibrate_uv, self.judge_uv = (
            wu2019.noisy(views, sigma_px, [(seed, part, run) for run in range(runs)])
            for part, views in enumerate(self.sky))
        self.covariance = wu2019.cramer_rao(self.sky.calibrate, sigma_px)

    @property
    def stars(self) -> float:
        """Stars a frame, on average."""
        return float(np.mean([len(view.uv) for view in self.sky.calibrate]))

    def run(self, measure: Measurement) -> Result:
        """Calibrate all runs by a method."""
        belief = wu2019.calibrate(self.sky.calibrate, self.calibrate_uv, self.sigma_px, measure)
        return Result(belief.parameters - TRUTH, self.criterion_A(belief.parameters),
                      wu2019.rmse_arcsec(belief.parameters, self.sky.judge, self.judge_uv),
                      wu2019.nees(belief))

    def criterion_A(self, parameters: Array) -> Array:
        """Return criterion A of parameters (runs, 6), (runs, frames) ["]."""
        return wu2019.rmse_arcsec(parameters, self.sky.judge,
                                  [view.uv[None] for view in self.sky.judge])

    def bound(self) -> dict[str, float]:
        """Return the least that each of the quantities can be on average."""
        draws = np.random.default_rng(0).standard_normal((_DRAWS, len(TRUTH)))
        error = draws @ np.linalg.cholesky(self.covariance).T
        B = wu2019.rmse_arcsec(np.tile(TRUTH, (len(self.judge_uv[0]), 1)), self.sky.judge,
                               self.judge_uv)
        drawn = Result(error, self.criterion_A(TRUTH + error), B, np.array([float(len(TRUTH))]))
        percent = 100.0 * np.sqrt(np.diag(self.covariance)) / np.abs(TRUTH)
        return {**drawn.quantities(), **dict(zip(PARAMETERS, percent.tolist()))}

    def frame_ms(self, measure: Measurement) -> float:
        """Return the time that the median frame takes one run that has converged [ms].

        Of each frame the best of some tries. W19 screens no stars, and neither does this.
        """
        belief = CameraBelief(TRUTH, np.linalg.cholesky(self.covariance).astype(float))
        frames = [Stars(view.u_i, uv[0], np.full(len(uv[0]), self.sigma_px))
                  for view, uv in zip(self.sky.judge, self.judge_uv)
                  if len(view.uv) >= MIN_STARS][:_TIMED]
        best = np.full(len(frames), np.inf)
        for _ in range(_TRIES):
            for k, stars in enumerate(frames):
                begin = perf_counter()
                attitude_free.update(belief, stars, LENS, measure)
                best[k] = min(best[k], perf_counter() - begin)
        return 1e3 * float(np.median(best))


def rows(case: str, quantities: tuple[str, ...], paper: dict[str, float],
         published: dict[str, float], full: dict[str, float], bound: dict[str, float]
         ) -> tuple[Row, ...]:
    """Return the rows of a table under HEAD; what is not known is left blank."""
    return tuple(
        (case, name, UNITS[name], paper.get(name, ''), published.get(name, ''), full[name],
         bound.get(name, ''), full[name] / bound[name] if name in bound else '')
        for name in quantities)
