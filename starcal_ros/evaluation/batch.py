# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Many independent runs of one scenario at once: the filter's leading axis.

All runs see the same motion, sky and camera; each has the noise of its own seed and is, to the
bit, what ``starcal simulate --seed`` makes. Stars are gated; the recovery of a lost attitude, a
matter of single streams, is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from starcal_ros.config.models import observer
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.units import NS
from starcal_ros.filter import arithmetic
from starcal_ros.filter.acquisition import WIDE, acquire, agreed
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.filter.error_state import Filter, Update
from starcal_ros.measurements.intake import in_gyro_time
from starcal_ros.measurements.preintegration import Preintegrated, preintegrate
from starcal_ros.measurements.samples import Frames, GyroSamples, Stars
from starcal_ros.measurements.star_directions import LEAST_SIGMA_PX
from starcal_ros.simulation import sensors
from starcal_ros.simulation.gyro import GyroSimulator
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places

_CHUNK = 500            # frames simulated at once


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


def follow(scenario: Scenario, seeds: Sequence[int],
           on_progress: Callable[[float], None] = lambda part: None, judged: bool = False
           ) -> Iterator[BatchFrame]:
    """Simulate and estimate one scenario with several seeds, and give what each frame does.

    The parameters are those of `batch_results.run_batch`.
    """
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
                            about.augmentation.gain(about.augmented), arithmetic.compose)


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
