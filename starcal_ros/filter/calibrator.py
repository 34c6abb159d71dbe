# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""From messages to estimates: what live node and offline command both run.

Gyro samples and frames come in as they arrive, in batches of any size. A frame is processed as
soon as a gyro sample reaches its stamp, whatever the order in which the two topics came, so the
estimates depend on the messages alone: a live run and the calibration of its recording agree.

Nothing that comes in stops the calibrator. What can not be used is dropped, counted (`Counts`) and
named once in `Calibrator.take_notices`. What is believed of the two topics `intake` tells: where
the clock of both was set back, the calibrator finishes what came before and starts again from the
nominal values.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from starcal_ros.config.estimator import EstimatorConfig
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.filter import arithmetic
from starcal_ros.filter.attitude_lock import AttitudeLock
from starcal_ros.filter.attitude_track import AttitudeTrack, AttitudeTracker
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.filter.error_state import Filter, Update
from starcal_ros.filter.frame_result import Counts, FrameResult, FrameResults
from starcal_ros.filter.message_queue import MessageQueue
from starcal_ros.filter.model_tests import ModelTests
from starcal_ros.filter.noise import Noise, noise_of
from starcal_ros.filter.ordinary_frames import OrdinaryFrames, can_do
from starcal_ros.filter.reprojection import Reprojection
from starcal_ros.filter.states import CALIBRATED
from starcal_ros.filter.trail import TrailTest
from starcal_ros.measurements import preintegration
from starcal_ros.measurements.intake import Change, Intake
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.preintegration import Preintegrated
from starcal_ros.measurements.samples import Frames, GyroSamples, Stars
from starcal_ros.measurements.star_directions import StarDirections

_BATCH = 2000               # frames prepared at once


class _Prepared(NamedTuple):
    """Frames and what they need, all of them made at once; ordinary where there may be some."""

    frames: Frames
    stars: Stars
    samples: GyroSamples
    cuts: Ints
    gyro: Preintegrated
    ordinary: OrdinaryFrames | None


class Calibrator:
    """Estimates from gyro samples and frames as they come.

    Parameters
    ----------
    scenario : Scenario
        Its nominal values, observer and estimator options; never its truth.
    covariance : (13, 13) array, optional
        Of the error of the nominal values, in place of the initial sigmas.
    noise : Noise, optional
        Where its levels come from; without it the data tell those of ``estimator.adapt``.
    """

    def __init__(self, scenario: Scenario, covariance: Array | None = None,
                 noise: Noise | None = None) -> None:
        self._scenario, self._covariance = scenario, covariance
        self.noise = noise or noise_of(scenario)
        self._period_ns = 1e9 / scenario.gyro.rate_hz
        self._frame_period_ns = 1e9 / scenario.star_tracker.rate_hz
        self._directions = StarDirections(scenario)
        self._notices = Notices()
        self._intake = Intake(scenario, self._notices)
        for text in self.noise.notices:
            self._notices.say(text)
        self._begin(restarts=0)

    def _begin(self, restarts: int) -> None:
        self._density = np.zeros(CALIBRATED.stop - CALIBRATED.start)    # of drifts that were seen
        self.noise.begin()
        self._trailing = True                           # stars, as far as is known
        self.filter = self._filter()
        self._trail_test = TrailTest(self.filter.model.trails)
        self.counts = Counts(restarts=restarts)
        self.belief: Belief | None = None
        self.stamp_ns = 0                               # of the last frame processed
        self._queue = MessageQueue(
            self._period_ns, self._frame_period_ns, self.counts, self._notices)
        self.consistency = self._tests()
        self._lock = AttitudeLock(
            self._scenario.estimator.reacquire_after_frames, self.counts, self._notices)
        self._reprojection = Reprojection()
        self._tracker = AttitudeTracker(self.filter, self._period_ns)

    def use(self, options: EstimatorConfig) -> None:
        """Go on with other gates and process noise, those that may change on the way."""
        self._scenario = replace(self._scenario, estimator=options)
        self.filter = self._tracker.filter = self._filter()
        self._lock.patience = options.reacquire_after_frames

    def _tests(self) -> ModelTests:
        tests = ModelTests(self.filter, self._scenario.estimator.gate_probability,
                           scores=self.noise.scores(self.filter, self._scenario.estimator))
        tests.noise_known = self.noise.known
        return tests

    def _filter(self) -> Filter:
        whole = Filter(self.noise.stated_in(self._scenario), self._covariance).walking(
            self._density)
        self._as_linear = not self.noise.known
        if self._as_linear:             # the sigmas are not: nothing can be held against them
            whole = whole.as_linear()
        return whole if self._trailing else whole.untrailed()

    # Coming in

    def add_gyro(self, samples: GyroSamples) -> None:
        """Take gyro samples, in the order in which they arrived."""
        self._intake.add_gyro(samples)
        self._take()

    def add_frames(self, frames: Frames) -> None:
        """Take frames, in the order in which they arrived."""
        self._intake.add_frames(frames)
        self._take()

    def _take(self) -> None:
        gyro, frames = self._intake.take()
        self.counts.dropped_messages += self._intake.take_dropped()
        self._queue.add(gyro, frames)

    def resume(self) -> None:
        """Go on from the last good belief after an error that ended `process`.

        What waited is dropped; see `_set_back`.
        """
        self._queue.drop()
        self._set_back()

    # Going out

    @property
    def waiting(self) -> int:
        """Number of frames that wait for a gyro sample to reach them."""
        return len(self._queue) + self._intake.waiting

    @property
    def next_frame_ns(self) -> int | None:
        """Stamp of the frame that a gyro sample has to reach next, None where none waits."""
        return self._queue.next_frame_ns

    def take_notices(self) -> list[str]:
        """Return what happened that a user should know, once."""
        return self._notices.take()

    def process(self, tracked: bool = False) -> Iterator[FrameResult]:
        """Process the frames that the gyro has reached, one by one; to be run to its end.

        Parameters
        ----------
        tracked : bool
            Give the attitude at the gyro samples before each frame along with it.
        """
        for results in self.stretches(tracked):
            yield from results

    def stretches(self, tracked: bool = False) -> Iterator[FrameResults]:
        """Do as `process`, with what several frames gave at once."""
        yield from self._process_reached(tracked)
        while change := self._intake.settle():
            if change is Change.RESTARTED:
                self._queue.drop()
                dropped = self.counts.dropped_messages
                self._begin(self.counts.restarts + 1)
                self.counts.dropped_messages = dropped
            self._take()
            yield from self._process_reached(tracked)

    def track(self) -> AttitudeTrack:
        """Return the attitude at each gyro sample since the last call, from the last update.

        With `process`, `tracked`, before it, each sample from the first frame on is given once.
        """
        return self._track(np.iinfo(np.int64).max)

    @property
    def tracking(self) -> bool:
        """Whether the stars agree with the attitude: most of the last frame was used."""
        return self.belief is not None and self._lock.holds

    def attitude_now(self) -> tuple[int, Array]:
        """Return the integrated attitude C_gi, (3, 3), at the last gyro sample, and its stamp.

        Only after a frame has given an attitude.
        """
        assert self.belief is not None
        return self._tracker.latest(
            self.belief, self.stamp_ns, self._queue.gyro.since(self.stamp_ns))

    @property
    def rate_covariance(self) -> Array:
        """Covariance of a rate of the track, (3, 3) [rad^2/s^2]: noise of a reading, and bias."""
        return self._tracker.rate_covariance(self.belief)

    @property
    def reprojection_rms_px(self) -> Array:
        """RMS residual of the stars used in the last ten minutes, u and v, (2,) [px]."""
        return self._reprojection.rms_px

    # Inside

    def _process_reached(self, tracked: bool) -> Iterator[FrameResults]:
        frames = self._queue.reached()
        for low in range(0, len(frames), _BATCH):
            yield from self._process(frames[low:low + _BATCH], tracked)

    def _process(self, frames: Frames, tracked: bool) -> Iterator[FrameResults]:
        prepared = self._prepared(frames)
        k = 0
        while k < len(frames):
            track = self._track(int(frames.stamp_ns[k])) if tracked else AttitudeTrack.empty()
            results, done = self._ordinary(prepared, k, track, 1 if tracked else len(frames))
            if results is not None:
                yield results
                k += done
                continue
            result = self._single(prepared, k, track)
            if result is not None:
                yield result.alone
            k += 1
        self._queue.gyro.forget_before(self.stamp_ns)

    def _prepared(self, frames: Frames) -> _Prepared:
        stars = self._directions.of(frames, self._notices)
        self.counts.unusable_stars += int(np.isinf(stars.sigma).sum())
        begin = int(frames.stamp_ns[0]) if self.belief is None else self.stamp_ns
        cuts = np.concatenate(([begin], frames.stamp_ns))
        samples = self._queue.gyro.since(begin)
        gyro = self._integrated(samples, cuts, self.filter.start)
        ordinary = (OrdinaryFrames(gyro, frames, self.noise.of_stars(stars))
                    if can_do(self.filter) else None)
        return _Prepared(frames, stars, samples, cuts, gyro, ordinary)

    def _ordinary(self, prepared: _Prepared, k: int, track: AttitudeTrack, most: int
                  ) -> tuple[FrameResults | None, int]:
        """Process the frames from the k-th on that need no second look; return how many, too."""
        belief, tests, frames = self.belief, self.consistency, prepared.frames
        if (prepared.ordinary is None or belief is None or self._lock.lost
                or self._lock.broken or self._trail_test.open or self._as_linear
                or tests.scores is not None):
            return None, 0
        found, look = prepared.ordinary.advance(k, most, self.filter, belief, tests)
        n = len(found.nis)
        if not n:
            return None, 0
        rows = slice(frames.first[k], frames.first[k + n])
        usable = np.isfinite(prepared.stars.sigma[rows])
        found.residual[~usable] = found.chi2[~usable] = np.nan
        stamps = frames.stamp_ns[k:k + n]
        results = prepared.ordinary.results(k, found, belief, track)
        self._reprojection.add(stamps, found.squares, found.used)
        self.stamp_ns, after = int(stamps[-1]), results.belief.of_run(-1)
        self._lock.hold()
        used = int(found.used.sum())
        self._count(n, used, int(usable.sum()) - used)
        try:
            tests.met(stamps, found)
            answered = self._answered(after) if look else after
        except np.linalg.LinAlgError:
            answered = None
        if answered is None or answered is not after and not answered.is_finite:
            self.belief = results.belief.of_run(-2) if n > 1 else belief
            self._leave_out(self.stamp_ns)
            return results.take(slice(-1)), n
        self.belief = answered
        return results if answered is after else results.ending_with(answered), n

    def _single(self, prepared: _Prepared, k: int, track: AttitudeTrack) -> FrameResult | None:
        """Process one frame, whatever it is like."""
        frames, stamp_ns = prepared.frames, int(prepared.frames.stamp_ns[k])
        rows = slice(frames.first[k], frames.first[k + 1])
        frame = self.noise.of_stars(prepared.stars.take(rows))
        belief, interval = self.belief, None
        if belief is not None:
            interval, before = prepared.gyro.take(k), belief.nominal
            # By what is believed now alone: not on how many frames came at once.
            if self.filter.strays(before, interval):
                interval = self._integrated(
                    prepared.samples, prepared.cuts[k:k + 2], before).take(0)
            belief, Phi = self.filter.propagated(belief, interval)
            self.consistency.carry(interval, before, belief.nominal, Phi,
                                   self.filter.noise(interval))
        self.stamp_ns = stamp_ns
        self.counts.empty_frames += not np.isfinite(frame.sigma).any()
        acquired = self.counts.acquisitions
        start = self._lock.begin(self.filter, belief, frame, prepared.gyro.reading[k], stamp_ns)
        if start is None:
            self.counts.frames += 1
            return None
        belief, frame = start
        afresh = self.counts.acquisitions > acquired
        if afresh:
            self.consistency.found()
        try:
            if not afresh:
                belief, frame, update = self._lock.update(
                    self.filter, belief, frame, interval, stamp_ns)
            else:
                update = self.filter.update(belief, frame, judged=True)
            self.consistency.meet(stamp_ns, belief.nominal, frame, update,
                                  frames.catalog_id[rows], frames.magnitude[rows])
            turn = self.consistency.turn
            answered = update.belief
            if self.consistency.due(stamp_ns):
                answered = self._answered(answered)
        except np.linalg.LinAlgError:
            answered = None
        if answered is None or not answered.is_finite:
            self.counts.frames += 1
            self._leave_out(stamp_ns)
            return None
        self.belief = answered
        if self._trail_test.denies(self.filter, belief.nominal, frame, update):
            self._rest(stamp_ns)
        found = self.noise.settle(self.consistency)
        if found or self.noise.known == self._as_linear:
            self.filter = self._tracker.filter = self._filter()
        usable = np.isfinite(prepared.stars.sigma[rows])
        self._account(update, usable)
        return FrameResult(stamp_ns, self.belief, frames.uv_raster[rows],
                           np.where(usable[:, None], update.residual, np.nan),
                           np.where(usable, update.chi2, np.nan), update.accepted,
                           frames.catalog_id[rows], frames.sigma[rows], float(update.nis), turn,
                           bool(update.linear), track)

    def _rest(self, stamp_ns: int) -> None:
        """Take the stars for such as do not trail; what was judged so far does not count."""
        self._trailing = False
        self.filter = self._tracker.filter = self._filter()
        self.consistency = self._tests()
        self._notices.say(f'stars do not trail while the camera turns, up to {stamp_ns} ns: '
                          'star_tracker.smear is taken for false from then on')

    def _leave_out(self, stamp_ns: int) -> None:
        """Say of a frame that it is not used, and doubt what may be wrong with it."""
        self._notices.once('finite', f'the frame at {stamp_ns} ns leaves nothing finite: '
                           'not used, what was believed before it stands')
        self._set_back()

    def _set_back(self) -> None:
        """Doubt all but the calibration believed so far: attitude, and tests of the model."""
        self._lock.doubt()
        self.consistency = self._tests()

    def _integrated(self, samples: GyroSamples, cuts: Ints, about: Nominal) -> Preintegrated:
        return preintegration.preintegrate(
            samples, cuts, about.bias, self._period_ns, about.augmentation.needs_matrix,
            about.augmentation.gain(about.augmented), arithmetic.compose)

    def _track(self, until_ns: int) -> AttitudeTrack:
        if self.belief is None:
            return AttitudeTrack.empty()
        return self._tracker.advance(
            self.belief, self.stamp_ns, self._queue.gyro.since(self.stamp_ns), until_ns)

    def _answered(self, belief: Belief) -> Belief:
        """Return a belief that knows of what has changed, where that is seen at this frame."""
        answer = self.consistency.answer(
            self.stamp_ns, self._scenario.estimator.answer_changes)
        if answer is None:
            return belief
        self._notices.say(f'{answer.change.sentence}; its covariance is opened')
        self._density = np.hypot(self._density, answer.density)
        self.filter = self._tracker.filter = self.filter.walking(answer.density)
        return self.filter.opened(belief, answer.error, answer.columns)

    def _account(self, update: Update, usable: Mask) -> None:
        used = int(update.accepted.sum())
        rejected = int(usable.sum()) - used
        self.consistency.account(used, rejected, self._lock.lost)
        self._count(1, used, rejected)
        self._lock.account(used, rejected, self.stamp_ns)
        self._reprojection.add(
            np.array([self.stamp_ns]),
            np.sum(update.residual[update.accepted]**2, axis=0, keepdims=True), np.array([used]))

    def _count(self, frames: int, used: int, rejected: int) -> None:
        self.counts.frames += frames
        self.counts.stars += used
        self.counts.rejected_stars += rejected
        self._lock.lost = False
