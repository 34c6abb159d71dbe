# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Some runs of one scenario over time: what the figures of T18 Sec. 3.1 and 3.4 are drawn from.

Stars that are held out
-----------------------
In the last ten minutes each frame is used a second time, from the same belief before it, without
every fifth of its stars, and the stars left out are predicted; what that update gives is then
thrown away. With the variance s of the predicted centroid after the update ::

    used        sigma^2 - s     the estimate leans towards the star's own noise
    held out    sigma^2 + s     the noise of the star, and the error of a prediction without it

are the variances that a filter which says the truth leaves.

The gyro alone
--------------
From the first fix on the readings, less the nominal bias, are integrated without the stars as
well. The drift since then is ``E(t) E(0)'``, E the rotation error of the attitude, in i.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.units import NS
from starcal_ros.evaluation import batch, bounds, tasks
from starcal_ros.evaluation.batch import BatchFrame
from starcal_ros.evaluation.estimation_error import TrueRuns, state_error
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.reprojection import REPROJECTION_S
from starcal_ros.filter.states import STATE_NAMES
from starcal_ros.filter.verdict import equivalent_sigma
from starcal_ros.simulation.motion import Motion

RUNS = 10               # share the work of a frame: ten take three times as long as one
SAMPLES = 720           # of a run: of two hours, one in 10 s
HELD_OUT = 5            # one star in so many

_BOUNDS = 13            # times of the second half: one in five minutes of an hour

_U0, _V0, _PSI_X, _PSI_Y = (STATE_NAMES.index(name) for name in ('u0', 'v0', 'psi_x', 'psi_y'))
_Residuals = tuple[Ints, Array, Array]


@dataclass(frozen=True)
class Traces:
    """What n runs did at m samples, and their q residuals of the last ten minutes.

    Attributes
    ----------
    time : (m,) array
        Since the start [s].
    error, sigma : (n, m, 16) array
        Estimate minus truth, T18's states, and what the filter states, in its units.
    equivalent_sigma : (n, m, 2) array
        What the filter states of the equivalent principal point, Eq. (V.1) of `verdict` [px].
    coupling : (n, m, 2) array
        Correlations that it states of u0 with Psi_y and of v0 with Psi_x.
    drift : (n, m, 3) array
        Of the gyro alone, since the first fix, in i [rad].
    run : (q,) int64 array
        Which run a residual is of.
    stamp : (q,) array
        When, since the start [s].
    residual : (q, 2) array
        Measured minus predicted centroid [px].
    variance : (q, 2) array
        That the filter states of it [px^2].
    held_out : (q,) bool array
        Whether the star was left out of the update.
    """

    time: Array
    error: Array
    sigma: Array
    equivalent_sigma: Array
    coupling: Array
    drift: Array
    run: Ints
    stamp: Array
    residual: Array
    variance: Array
    held_out: Mask

    @property
    def second_half(self) -> Mask:
        """Which samples lie in the second half, T18's second hour, (m,)."""
        return self.time >= 0.5 * self.time[-1]


def of(scenario: Scenario, runs: int, work: Path,
       on_progress: Callable[[float], None] = lambda part: None) -> Traces:
    """Return the traces of runs with the scenario's seed and the next ones.

    They are kept in the folder `work`, for the next figure that is drawn from the same runs.
    """
    kept = work / f'traces_{scenario.sha256[:16]}_{runs}.npz'
    if not kept.exists():
        work.mkdir(parents=True, exist_ok=True)
        tasks.save(kept, asdict(_traced(scenario, runs, on_progress)))
    on_progress(1.0)
    with np.load(kept) as arrays:
        return Traces(**arrays)


def bounds_of_second_half(scenario: Scenario) -> Array:
    """Return the bound on the covariance at `_BOUNDS` times of the second half, (_, 16, 16)."""
    return bounds.after(scenario, np.linspace(
        0.5, 1.0, _BOUNDS, dtype=np.float64) * scenario.simulation.duration_s)


def _traced(scenario: Scenario, runs: int, on_progress: Callable[[float], None]) -> Traces:
    filter_ = Filter(scenario)
    seeds = range(scenario.simulation.seed, scenario.simulation.seed + runs)
    truth, start_ns = TrueRuns.of(scenario, seeds), Motion.from_scenario(scenario).start_ns
    count = batch.frame_count(scenario)
    every = max(1, count // SAMPLES)
    last_minutes = count - round(REPROJECTION_S * scenario.star_tracker.rate_hz)
    samples: list[tuple[float, Array, Array, Array, Array, Array]] = []
    residuals: list[tuple[NDArray[Any], ...]] = []
    alone = first_error = np.eye(3)
    for step in batch.follow(scenario, seeds, on_progress):
        belief, true = step.update.belief, truth.at(step.stamp_ns)
        estimate, time = belief.estimate, (step.stamp_ns - start_ns) * NS
        if step.gyro is None:
            alone, first_error = estimate.C_gi, true.C_gi.T @ estimate.C_gi
        else:
            alone = step.gyro.Delta @ alone
        if step.number % every == 0 or step.number + 1 == count:
            drift = rotation.log(true.C_gi.T @ alone @ np.swapaxes(first_error, -1, -2))
            root = belief.state_root
            samples.append((
                time, state_error(estimate, true), belief.sigma, equivalent_sigma(
                    root, estimate.intrinsics, filter_.detector.pitch_mm),
                coupling(root @ np.swapaxes(root, -1, -2)), drift))
        if step.number >= last_minutes:
            used, held_out = _residuals(filter_, step)
            for stars, held in ((used, False), (held_out, True)):
                run, *found = stars
                residuals.append((run, np.full(len(run), time), *found, np.full(len(run), held)))
    times, *states = zip(*samples)
    values = [np.array(times), *(np.stack(part, axis=1) for part in states),
              *(np.concatenate(part) for part in zip(*residuals))]
    return Traces(*values)


def _residuals(filter_: Filter, step: BatchFrame) -> tuple[_Residuals, _Residuals]:
    """Return runs, residuals and variances of the stars used and of the stars held out."""
    stars, update = step.stars, step.update
    left_out = np.arange(stars.sigma.shape[-1]) % HELD_OUT == step.number % HELD_OUT
    without = filter_.update(step.predicted, stars._replace(
        sigma=np.where(left_out, np.inf, stars.sigma)))
    held = left_out & np.isfinite(stars.sigma)
    return (_selected(update.residual, stars.sigma[..., None]**2
                      - _variance(filter_, update.belief, stars.u_i), update.accepted),
            _selected(without.residual, stars.sigma[..., None]**2
                      + _variance(filter_, without.belief, stars.u_i), held))


def _selected(residual: Array, variance: Array, which: Mask) -> _Residuals:
    return np.nonzero(which)[0], residual[which], variance[which]


def _variance(filter_: Filter, belief: Belief, u_i: Array) -> Array:
    """Return the variance of predicted centroids, (..., n, 2) [px^2]."""
    _, H, _ = filter_.model.predict(belief.nominal, u_i)
    M = (H * filter_.scale) @ belief.root[..., None, :, :]
    return np.einsum('...i,...i->...', M, M)


def coupling(covariance: Array) -> Array:
    """Return the correlations of u0 with Psi_y and of v0 with Psi_x, (..., 2)."""
    first, second = np.array([_U0, _V0]), np.array([_PSI_Y, _PSI_X])
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    return covariance[..., first, second] / np.sqrt(variance[..., first] * variance[..., second])
