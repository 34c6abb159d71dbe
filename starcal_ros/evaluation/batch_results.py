# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What many runs of a scenario gave: errors, sigmas, consistency, verdicts.

Errors are kept now and then; sums over the frames go on from frame to frame, so that the memory
does not grow with the length of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import NS
from starcal_ros.evaluation.batch import BatchFrame, follow, frame_count
from starcal_ros.evaluation.estimation_error import TrueRuns, attitude_error, state_error
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.model_tests import ModelTests
from starcal_ros.filter.reprojection import REPROJECTION_S
from starcal_ros.filter.states import CALIBRATED
from starcal_ros.filter.verdict import word

RECORD_S = 60.0         # between the errors that are kept, at most a twentieth of the run


@dataclass(frozen=True)
class Runs:
    """What n runs gave.

    Attributes
    ----------
    seed : (n,) int64 array
        Seeds.
    time : (n, m) array
        When the errors were taken, the last of them after the last frame [s].
    error : (n, m, 16 + k) array
        Estimate minus truth at that time, T18's states and then the k values of the optional ones
        that are on, in the filter's units.
    sigma : (n, m, 16 + k) array
        What the filter states.
    nees : (n, m) array
        Normalised estimation error squared, 16 + k degrees of freedom.
    nis, nis_degrees : (n,) array
        Sums over the frames for which the linear model held: normalised innovations squared,
        their degrees of freedom.
    attitude_rms : (n, 3) array
        RMS of phi over the second half of the run [rad].
    reprojection_rms : (n, 2) array
        RMS of measured minus predicted centroids over the last ten minutes [px].
    verdict : (n,) str array
        What the tests of the model, and the tolerances, make of each run; '' where they were not
        judged.
    failed : (n,) str array
        Names of the tests that fail, with '; ' between them.
    """

    seed: Ints
    time: Array
    error: Array
    sigma: Array
    nees: Array
    nis: Array
    nis_degrees: Array
    attitude_rms: Array
    reprojection_rms: Array
    verdict: NDArray[np.str_]
    failed: NDArray[np.str_]

    @classmethod
    def concatenate(cls, parts: Sequence[Runs]) -> Runs:
        """Join batches."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts])
                     for field in fields(cls)))


def run_batch(scenario: Scenario, seeds: Sequence[int],
              on_progress: Callable[[float], None] = lambda part: None,
              judged: bool = False) -> Runs:
    """Simulate and estimate one scenario with several seeds.

    Parameters
    ----------
    scenario : Scenario
        Its own seed does not matter.
    seeds : sequence of int
        One for each run.
    on_progress : callable
        Called with the part done, 0 to 1.
    judged : bool
        Test the model in each run as a calibrator does, which takes as long again.
    """
    tally = _Tally(TrueRuns.of(scenario, seeds), frame_count(scenario), scenario, judged)
    for step in follow(scenario, seeds, on_progress, judged):
        tally.add(step)
    return tally.runs()


class _Tally:
    """Collects what `Runs` holds."""

    def __init__(self, truth: TrueRuns, frames: int, scenario: Scenario, judged: bool) -> None:
        rate_hz = scenario.star_tracker.rate_hz
        self._truth, self._frames = truth, frames
        self._filter = Filter(scenario)
        self._tests = ModelTests(self._filter, scenario.estimator.gate_probability,
                                 (len(truth.seeds),)) if judged else None
        self._every = max(1, min(round(RECORD_S * rate_hz), frames // 20))
        self._last_minutes = frames - round(REPROJECTION_S * rate_hz)
        n = len(truth.seeds)
        self._time: list[float] = []
        self._error: list[Array] = []
        self._sigma: list[Array] = []
        self._nees: list[Array] = []
        self._nis, self._degrees = np.zeros(n), np.zeros(n)
        self._phi, self._squares, self._used = np.zeros((n, 3)), np.zeros((n, 2)), np.zeros(n)

    def add(self, step: BatchFrame) -> None:
        """Take what one frame gave."""
        update, number = step.update, step.number
        if self._tests is not None:
            _test(self._tests, self._filter, step)
        self._nis += np.where(update.linear, update.nis, 0.0)
        self._degrees += np.where(update.linear, 2.0 * update.accepted.sum(axis=-1), 0.0)
        if number >= self._last_minutes:
            residual = np.where(update.accepted[..., None], update.residual, 0.0)
            self._squares += np.sum(residual**2, axis=-2)
            self._used += update.accepted.sum(axis=-1)
        second_half, kept = 2 * number >= self._frames, (number + 1) % self._every == 0
        if not (second_half or kept or number + 1 == self._frames):
            return
        belief, true = update.belief, self._truth.at(step.stamp_ns)
        estimate = belief.estimate
        if second_half:
            self._phi += attitude_error(estimate.C_gi, true)**2
        if kept or number + 1 == self._frames:
            self._time.append((step.stamp_ns - self._truth.truths[0].motion.start_ns) * NS)
            self._error.append(state_error(estimate, true))
            self._sigma.append(np.concatenate((belief.sigma, belief.augmented_sigma), axis=-1))
            self._nees.append(belief.nees(true))

    def runs(self) -> Runs:
        """Return it all."""
        n = len(self._truth.seeds)
        verdict, failed = self._judged(n)
        half = self._frames - (self._frames + 1) // 2
        return Runs(np.array(self._truth.seeds, np.int64), np.tile(self._time, (n, 1)),
                    np.stack(self._error, axis=1), np.stack(self._sigma, axis=1),
                    np.stack(self._nees, axis=1), self._nis, self._degrees,
                    np.sqrt(self._phi / max(half, 1)),
                    np.sqrt(self._squares / np.maximum(self._used, 1.0)[:, None]),
                    verdict, failed)

    def _judged(self, n: int) -> tuple[NDArray[np.str_], NDArray[np.str_]]:
        """Return the verdict on each run and the tests that fail."""
        if self._tests is None:
            return np.full(n, ''), np.full(n, '')
        tests = [self._tests.statistics((run,)) for run in range(n)]
        known = (self._sigma[-1][:, CALIBRATED] <= self._filter.tolerance).all(axis=-1)
        return (np.array([word(bool(inside), True, each) for inside, each in zip(known, tests)]),
                np.array(['; '.join(test.name for test in each if not test.passed)
                          for each in tests]))


def _test(tests: ModelTests, filter_: Filter, step: BatchFrame) -> None:
    """Tell the tests of the model of a frame."""
    if step.before is not None and step.gyro is not None and step.transition is not None:
        tests.carry(step.gyro, step.before, step.predicted.nominal, step.transition,
                    filter_.noise(step.gyro))
    tests.meet(step.stamp_ns, step.predicted.nominal, step.stars, step.update, step.catalog_id,
               step.magnitude)
    tests.candidate(step.stamp_ns)
