# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Many independent runs of one scenario at once: the filter's leading axis.

All runs see the same motion, sky and camera; each has the noise of its own seed and is, to the
bit, what ``starcal simulate --seed`` makes. Stars are gated; the recovery of a lost attitude, a
matter of single streams, is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.models import observer
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.units import NS
from starcal_ros.evaluation.augmented import true_values
from starcal_ros.filter.acquisition import WIDE, acquire, agreed
from starcal_ros.filter.augmentation import NONE, Augmentation
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.filter.calibrator import REPROJECTION_S
from starcal_ros.filter.error_state import Filter, Update
from starcal_ros.filter.model_tests import ModelTests
from starcal_ros.filter.states import CALIBRATED, N_STATES, PHI
from starcal_ros.filter.verdict import word
from starcal_ros.measurements.intake import in_gyro_time
from starcal_ros.measurements.preintegration import Preintegrated, preintegrate
from starcal_ros.measurements.samples import Frames, GyroSamples, Stars
from starcal_ros.measurements.star_directions import LEAST_SIGMA_PX
from starcal_ros.simulation import sensors
from starcal_ros.simulation.gyro import GyroSimulator
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places

RECORD_S = 60.0         # between the errors that are kept, at most a twentieth of the run
_CHUNK = 500            # frames simulated at once


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


class BatchFrame(NamedTuple):
    """One frame of all runs of a batch.

    Attributes
    ----------
    number : int
        Of the frame, from 0.
    stamp_ns : int
        Its stamp.
    gyro : Preintegrated or None
        Since the frame before; None at the first frame.
    stars : Stars
        The frame.
    predicted : Belief
        Before the frame.
    update : Update
        What the frame did, with its evidence where the runs are judged.
    before : Nominal or None
        At the beginning of the interval; None at the first frame.
    transition : Array or None
        Of the scaled errors over it.
    catalog_id : (runs, n) int64 array
        Of the stars.
    magnitude : (runs, n) array
        NaN where it is not known.
    """

    number: int
    stamp_ns: int
    gyro: Preintegrated | None
    stars: Stars
    predicted: Belief
    update: Update
    before: Nominal | None
    transition: Array | None
    catalog_id: Ints
    magnitude: Array


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


def follow(scenario: Scenario, seeds: Sequence[int],
           on_progress: Callable[[float], None] = lambda part: None, judged: bool = False
           ) -> Iterator[BatchFrame]:
    """Simulate and estimate as `run_batch` does, and give what each frame does."""
    runs = [scenario.replace({'simulation.seed': int(seed)}) for seed in seeds]
    trackers = [sensors.star_tracker(run) for run in runs]
    gyros = [_Gyro(sensors.gyro(run), scenario.gyro.rate_hz) for run in runs]
    filter_ = Filter(scenario)
    belief: Belief | None = None
    cut_ns: list[int] = []
    for done in range(0, trackers[0].count, _CHUNK):
        frames = [in_gyro_time(tracker.next(_CHUNK), scenario) for tracker in trackers]
        stamps = frames[0].stamp_ns
        stars, numbers, magnitudes, counts = _padded(frames, scenario, filter_)
        cuts = np.concatenate((cut_ns or stamps[:1], stamps))
        gyro = Preintegrated.stacked([g.preintegrate(cuts, filter_.start) for g in gyros], axis=1)
        cut_ns = [int(stamps[-1])]
        for k, stamp_ns in enumerate(stamps.tolist()):
            frame, turned = Stars(*(part[:, k, :counts[k]] for part in stars)), None
            acquired, before, transition = belief is None, None, None
            if belief is None:
                belief, frame = _acquired(filter_, frame, gyro.take(0).reading)
            else:
                turned = gyro.take(k)
                strays = filter_.strays(belief.nominal, turned)
                if strays.any():
                    turned = Preintegrated.stacked([
                        g.again(cuts[k:k + 2], belief.nominal.of_run(run)).take(0)
                        if strays[run] else turned.take(run) for run, g in enumerate(gyros)])
                before = belief.nominal
                belief, transition = filter_.propagated(belief, turned)
            update = filter_.update(belief, frame, judged=judged, gyro=turned)
            if not acquired and (update.spread > WIDE).any():
                belief, frame = _agreed(filter_, belief, frame, update.spread > WIDE)
                update = filter_.update(belief, frame, judged=judged, gyro=turned)
            yield BatchFrame(done + k, stamp_ns, turned, frame, belief, update, before,
                             transition, numbers[:, k, :counts[k]], magnitudes[:, k, :counts[k]])
            belief = update.belief
        on_progress(min(1.0, (done + _CHUNK) / trackers[0].count))


def frame_count(scenario: Scenario) -> int:
    """Return how many frames a run has."""
    return sensors.star_tracker(scenario).count


def nominal(truth: Truth, stamp_ns: int, augmentation: Augmentation = NONE) -> Nominal:
    """Return the true values at a stamp, where bias and mounting are on their way there."""
    stamp = np.array([stamp_ns])
    return Nominal(truth.motion.attitude(stamp)[0].T, truth.bias_at(stamp)[0],
                   truth.mounting_at(stamp)[0], truth.intrinsics,
                   true_values(augmentation, truth), augmentation=augmentation)


@dataclass(frozen=True)
class TrueRuns:
    """The true values behind the runs of a batch.

    Attributes
    ----------
    seeds : sequence of int
        One for each run.
    truths : sequence of Truth
        Of each run; the first alone where nothing moves, since they then differ in nothing.
    augmentation : Augmentation
        Which optional states the filter has.
    """

    seeds: Sequence[int]
    truths: Sequence[Truth]
    augmentation: Augmentation

    @classmethod
    def of(cls, scenario: Scenario, seeds: Sequence[int]) -> TrueRuns:
        """Return those of a scenario with several seeds."""
        truths = [Truth.from_scenario(scenario.replace({'simulation.seed': int(seed)}))
                  for seed in seeds]
        return cls(seeds, truths if truths[0].moves else truths[:1],
                   Augmentation.of(scenario.estimator.augment))

    def at(self, stamp_ns: int) -> Nominal:
        """Return the true values at a stamp; bias and mounting of each run where they move."""
        first, stamp = self.truths[0], np.array([stamp_ns])
        true = nominal(first, stamp_ns, self.augmentation)
        if not first.moves:
            return true
        return replace(true, bias=np.stack([run.bias_at(stamp)[0] for run in self.truths]),
                       C_sg=np.stack([run.mounting_at(stamp)[0] for run in self.truths]))


def attitude_error(C_gi: Array, true: Nominal) -> Array:
    """Return phi, (..., 3), of attitudes (..., 3, 3) [rad], T18 Eq. 7."""
    return rotation.log(true.C_gi.T @ C_gi)


def state_error(estimate: Nominal, true: Nominal) -> Array:
    """Return the errors of T18's states and of augmented values, (..., 16 + m)."""
    error = estimate.minus(true)
    error[..., PHI] = attitude_error(estimate.C_gi, true)
    error[..., N_STATES:] = estimate.augmented - true.augmented
    return error


class _Gyro:
    """One run's readings, made as far as they are needed."""

    def __init__(self, simulator: GyroSimulator, rate_hz: float) -> None:
        self._simulator, self._rate_hz = simulator, rate_hz
        self._samples = GyroSamples.empty()

    def preintegrate(self, cuts_ns: Ints, about: Nominal) -> Preintegrated:
        missing = cuts_ns[-1] - self._simulator.stamp_ns(self._simulator.next_index - 1)
        count = max(int(np.ceil(missing * NS * self._rate_hz - 1e-6)),
                    0 if len(self._samples) else 1)
        first = int(np.searchsorted(self._samples.stamp_ns, cuts_ns[0], side='right')) - 1
        self._samples = GyroSamples.concatenate(
            (self._samples[max(first, 0):], self._simulator.next(count)))
        return self.again(cuts_ns, about)

    def again(self, cuts_ns: Ints, about: Nominal) -> Preintegrated:
        return preintegrate(self._samples, cuts_ns, about.bias, 1e9 / self._rate_hz,
                            about.augmentation.needs_matrix,
                            about.augmentation.gain(about.augmented))


def _padded(frames: Sequence[Frames], scenario: Scenario, filter_: Filter
            ) -> tuple[Stars, Ints, Array, Ints]:
    """Return the stars of all runs, (runs, frames, n, ...), and how many each frame has at most.

    Places that a frame does not fill have an infinite sigma. Numbers and magnitudes stand between.
    """
    counts = np.stack([part.star_counts for part in frames]).max(axis=0)
    shape = (len(frames), len(counts), int(counts.max(initial=0)))
    padded = Stars(np.broadcast_to([0.0, 0.0, 1.0], (*shape, 3)).copy(), np.zeros((*shape, 2)),
                   np.full(shape, np.inf))
    numbers, magnitudes = np.zeros(shape, np.int64), np.full(shape, np.nan)
    u_i: Array = np.empty((0, 3))
    for run, part in enumerate(frames):
        known = run > 0 and np.array_equal(part.catalog_id, frames[run - 1].catalog_id)
        if not known:
            stars = catalog.load_containing(part.catalog_id)
            row = stars.rows(part.catalog_id)
            u_i = apparent_places(stars, np.maximum(row, 0), part.stamp_ns, part.star_counts,
                                  observer(scenario.observer))
        k = part.frame_index
        rank = np.arange(len(k)) - part.first[k]
        numbers[run, k, rank], magnitudes[run, k, rank] = part.catalog_id, part.magnitude
        padded.u_i[run, k, rank] = u_i
        padded.uv[run, k, rank] = part.uv_raster - filter_.detector.centre_raster
        sigma = np.where(part.sigma > 0.0, part.sigma, scenario.star_tracker.centroid_sigma_px)
        padded.sigma[run, k, rank] = np.where(row >= 0, np.maximum(sigma, LEAST_SIGMA_PX), np.inf)
    return padded, numbers, magnitudes, counts


def _acquired(filter_: Filter, frame: Stars, reading: Array) -> tuple[Belief, Stars]:
    """Find the attitude of each run and stack the beliefs."""
    found = [acquire(filter_, None, frame.take(run), reading[run])
             for run in range(len(frame.sigma))]
    return _together(found, frame)


def _agreed(filter_: Filter, belief: Belief, frame: Stars, wide: Mask) -> tuple[Belief, Stars]:
    """Judge the stars of some runs together."""
    runs = [(belief.of_run(run), frame.take(run)) for run in range(len(frame.sigma))]
    return _together([agreed(filter_, *run) if w else run for run, w in zip(runs, wide)], frame)


def _together(found: Sequence[tuple[Belief, Stars]], frame: Stars) -> tuple[Belief, Stars]:
    return (Belief.stacked([belief for belief, _ in found]),
            frame._replace(sigma=np.stack([stars.sigma for _, stars in found])))


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
