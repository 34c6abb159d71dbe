# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether the frames are what the filter expects, and which effect explains it where not.

A calibrator, or a batch of runs, tells of each interval and each frame; `statistics` has the tests
of the innovations (`innovation_tests`), of effects that the model leaves out and of steps
(`effect_tests`), at a constant cost a frame.

A step is answered: the filter opens the covariance of what has changed, and the tests begin again.
What calls for a second answer soon after is no step, but something else that is wrong.

Frames whose prediction is less certain than the stars themselves (the first ones, and those after
a gap) are passed over: there the linear model is not good to what is asked here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.statistic import ALARM, Statistic, gated_nis, normal_beyond
from starcal_ros.filter import arithmetic, hypotheses
from starcal_ros.filter.allowances import SCATTER, WINDOW
from starcal_ros.filter.belief import Nominal
from starcal_ros.filter.changes import N_EFFECTS, Answer, Changes, ModelChange
from starcal_ros.filter.effect_tests import STEADY, STEPS, Effect, Weighed, told, weighed
from starcal_ros.filter.error_state import Filter, Update
from starcal_ros.filter.frame_innovation import FrameInnovation
from starcal_ros.filter.hypotheses import CHANGING, LARGEST_STEPS
from starcal_ros.filter.innovation_tests import NOISE_TESTS, InnovationTests
from starcal_ros.filter.likelihood import Likelihood
from starcal_ros.filter.noise_levels import Scores
from starcal_ros.filter.reference import TurnFound
from starcal_ros.filter.responses import WIDTH, Fit, Responses
from starcal_ros.filter.states import N_STATES, THETA
from starcal_ros.filter.stretch import Gained, TestSums
from starcal_ros.measurements.preintegration import Preintegrated
from starcal_ros.measurements.samples import Stars

HISTORY = 200
"""Windows of which the statistics are kept, at most."""
LEAST = 20
"""Frames before a statistic says anything."""
BY_NOISE = 0.2
"""Part of what is known of an optional state that noise of the gyro may have feigned."""

SELDOM_NS = 3600 * 10**9
"""Time after a change that was answered in which there is no second answer."""


class ModelTests:
    """The tests of one run, or of all runs of a batch.

    Parameters
    ----------
    filter_ : Filter
        Whose innovations they are.
    gate_probability : float
        With which a good star passes its gate.
    batch : tuple of int
        Leading axes.
    scores : Scores, optional
        Of noise levels, of one run: to be told of what comes, too.

    Attributes
    ----------
    likelihood : Likelihood
        Of the frames so far.
    noise_known : bool
        False where the noise is sought: that it is not as stated does not speak against the model.
    history : list of (int, tuple of Statistic)
        What the statistics of the first run were at the end of each window, and its stamp; of a
        run of more than `HISTORY` windows every second, every fourth and so on.
    changes : list of ModelChange
        Steps and drifts that were answered.
    turn : (3,) array
        e of the last frame of the first run, Eq. (C.1); NaN where it was passed over.
    gated : float
        Of `InnovationTests`.
    """

    def __init__(self, filter_: Filter, gate_probability: float, batch: tuple[int, ...] = (),
                 scores: Scores | None = None) -> None:
        self._half = 0.5 * np.array([filter_.detector.width, filter_.detector.height])
        self._n, self._batch, self._runs = len(filter_.scale), batch, arithmetic.LeadingAxes(batch)
        self.gated = gated_nis(gate_probability)
        self.history: list[tuple[int, tuple[Statistic, ...]]] = []
        self.changes: list[ModelChange] = []
        self.likelihood = Likelihood(filter_.detector)
        self.scores, self.noise_known = scores, True
        self._noise, self._afresh = np.zeros(2), False  # of the interval before the next frame
        self.turn: Array = np.full(3, np.nan)
        self._by_noise = self._beside = np.full(batch, np.nan)     # nothing is told
        self._prior = filter_.initial_sigma[N_STATES:]
        self._known = filter_.augmentation.effects
        self._thinned = 1
        self._windows = 0
        self.begin()

    def begin(self) -> None:
        """Begin the tests, as at the first frame and after what was answered."""
        self._tests = {run: InnovationTests(self.gated) for run in np.ndindex(*self._batch)}
        self._responses = Responses(self._batch, self._n, np.concatenate((
            hypotheses.largest(), np.tile(LARGEST_STEPS, (N_EFFECTS // len(CHANGING), 1)))))
        self._changes = Changes()
        self._root = np.broadcast_to(np.eye(self._n), (*self._batch, self._n, self._n))
        self._since: dict[str, int] = {}

    # Coming in

    def carry(self, gyro: Preintegrated, before: Nominal, after: Nominal, Phi: Array,
              noise: Array) -> None:
        """Know of an interval.

        Parameters
        ----------
        gyro : Preintegrated
        before, after : Nominal
            At its beginning and its end.
        Phi : (..., n, n) array
            Transition of the scaled errors.
        noise : (..., 2) array
            From `Filter.noise`.
        """
        runs, self._noise = self._runs, noise
        arithmetic.carry(
            runs(self._responses.E, 2), runs(Phi, 2), runs(before.C_gi, 2), runs(after.C_gi, 2),
            runs(after.C_sg, 2), runs(gyro.Delta, 2), runs(gyro.J, 2), runs(gyro.duration, 0))
        if self.scores is not None:
            self.scores.carry(gyro, Phi)

    def found(self) -> None:
        """Know that the attitude was found afresh."""
        self._responses.forget(THETA)
        self._changes.found()
        self._afresh = True
        if self.scores is not None:
            self.scores.found()

    def meet(self, stamp_ns: int, predicted: Nominal, stars: Stars, update: Update,
             catalog_id: Ints, magnitude: Array) -> None:
        """Know of a frame.

        Parameters
        ----------
        stamp_ns : int
        predicted : Nominal
            Before it.
        stars : Stars
        update : Update
            What it did, with its evidence.
        catalog_id : (..., n) int64 array
        magnitude : (..., n) array
            NaN where it is not known.
        """
        self._root = update.belief.root
        rate = (predicted.C_sg @ (predicted.reading - predicted.bias)[..., None])[..., 0]
        found = self._judged(predicted, stars, update, rate, magnitude)
        noise = np.broadcast_to(self._noise, (*self._batch, 2))
        self._noise, self._afresh = np.zeros(2), False
        # The scatter of a frame that is believed less is not what is stated.
        judged = found.judged & np.ravel(update.linear)
        self.turn = found.e[0] if judged[0] else np.full(3, np.nan)
        used = update.accepted.sum(axis=-1)
        self.likelihood.add(np.array([stamp_ns]), used[None],
                            self._runs.back(found.log_det)[None], update.nis[None])
        if self.scores is not None:
            assert update.evidence is not None
            turn = float(found.e[0] @ found.e[0]) if judged[0] else 0.0
            self.scores.meet(update.evidence, float(update.nis) - turn, 2 * int(used) - 3,
                             bool(judged[0]))
        ended = False
        for k, (run, tests) in enumerate(self._tests.items()):
            if not judged[k]:
                tests.pass_over()
                continue
            use = update.accepted[run]
            ended = tests.add(FrameInnovation(
                found.e[k], found.L[k], float(update.nis[run]), int(used[run]), rate[run],
                catalog_id[run][use], found.normal[k][use], found.cell[k][use],
                magnitude[run][use], float(noise[run][0]))) or ended
        if ended:
            self._keep(stamp_ns)

    def _judged(self, predicted: Nominal, stars: Stars, update: Update, rate: Array,
                magnitude: Array) -> TurnFound:
        """Take a frame into the responses; return what it says of the turn before it."""
        said, responses, runs = update.evidence, self._responses, self._runs
        assert said is not None
        drawn = self._drawn(update)     # by the responses before the frame
        found = arithmetic.judge(
            runs(said.z, 1), runs(said.H, 2), runs(said.M, 2), runs(said.L, 2), runs(said.root, 2),
            runs(responses.E, 2), runs(responses.s, 2), runs(responses.information, 3),
            runs(predicted.C_si, 2), runs(rate, 1), runs(stars.u_i, 2), runs(update.place, 2),
            runs(stars.sigma, 1), runs(magnitude, 1), runs(update.accepted, 1),
            runs(np.where(self._afresh, np.inf, update.spread), 0), runs(update.nis, 0),
            self._half, runs(predicted.C_sg, 2), runs(self._noise, 1))
        if drawn is not None:
            responses.s[:] -= np.where(runs.back(found.judged)[..., None, None],
                                       drawn.reshape(responses.s.shape), 0.0)
        return found

    def _drawn(self, update: Update) -> Array | None:
        """Return what noise of the gyro adds to the scores, by way of the optional states."""
        if update.drawn is None:
            return None
        belief = update.belief
        self._by_noise = np.max(belief.told_by_noise, axis=-1)
        self._beside = np.max(np.abs(belief.estimate.augmented) / self._prior, axis=-1)
        return np.swapaxes(self._responses.E, -1, -2) @ update.drawn[..., None]

    def rows(self, catalog_id: Ints) -> Ints:
        """Return where stars stand in `sums`, of one run."""
        return self._tests[()].rows(catalog_id)

    @property
    def sizes(self) -> Array:
        """Largest sizes of the effects that are thought of, (g, 3)."""
        return self._responses.largest

    def sums(self) -> TestSums:
        """Return what frames add to that are processed in one go, of one run."""
        responses, changes = self._responses, self._changes
        return TestSums._make((
            responses.E[None], responses.s[None], responses.information[None],
            *self._tests[()].sums(), changes.slots, changes.counts))

    def met(self, stamp_ns: Ints, found: Gained) -> None:
        """Know of frames that were added to `sums`."""
        self._root, self.turn = found.root[-1], found.turn[-1]
        self.likelihood.add(stamp_ns, found.used, found.log_det, found.nis)
        if self._tests[()].end_window():
            self._keep(int(stamp_ns[-1]))

    def account(self, used: int, rejected: int, lost: bool) -> None:
        """Count the stars of a frame, and whether the attitude was lost before it, of one run."""
        self._tests[()].account(used, rejected, lost)

    def _keep(self, stamp_ns: int) -> None:
        self._windows += 1
        statistics = self.statistics(next(iter(self._tests)))
        failing = {each.name for each in statistics if not each.passed}
        self._since = {name: self._since.get(name, stamp_ns) for name in failing}
        if self._windows % self._thinned == 0:
            self.history.append((stamp_ns, statistics))
        if len(self.history) == HISTORY:
            del self.history[::2]
            self._thinned *= 2

    # Going out

    def candidate(self, stamp_ns: int) -> None:
        """Let a candidate for a step begin where one is due, without an answer to any.

        To be called after each frame of a batch.
        """
        if self.due(stamp_ns):
            self._changes.begin(stamp_ns, False, self._responses)

    def due(self, stamp_ns: int) -> bool:
        """Count a frame, and tell whether `answer` is to look at it."""
        return self._changes.due(stamp_ns)

    def answer(self, stamp_ns: int, wanted: bool = True) -> Answer | None:
        """Return what has changed and what follows for the filter, of one run; mostly None.

        With an answer all tests begin again. Where it is not wanted, None: what has changed fails
        its test.
        """
        found, fit = None, self._fit()
        seldom = not self.changes or stamp_ns > self.changes[-1].found_ns + SELDOM_NS
        if wanted and seldom:
            noise_as_stated = all(
                1.0 / SCATTER < factor < SCATTER for factor in self.variance_factors())
            found = self._changes.find(stamp_ns, fit, self._responses, noise_as_stated)
        if found is None:
            # What is awaited may have begun after all other candidates did.
            self._changes.begin(stamp_ns, self._changes.awaited or self._clean(fit),
                                self._responses)
            return None
        self.changes.append(found.change)
        self.begin()
        return found

    def _clean(self, fit: Fit) -> bool:
        """Tell whether there is a window at least, and nothing that speaks against the model."""
        return self._tests[()].frames >= WINDOW and all(
            each.passed for each in self._tests[()].statistics()
            if self.noise_known or each.name not in NOISE_TESTS) and all(
            each.counted <= each.bound for each in self._effects((), fit))

    def statistics(self, run: tuple[int, ...] = ()) -> tuple[Statistic, ...]:
        """Return all tests of one run; none while there are too few frames."""
        tests = self._tests[run]
        if tests.frames < LEAST:
            return ()
        fit = self._fit(run)
        found = (*tests.statistics(), *(
            each.statistic(fit, tests.frames) for each in self._effects(run, fit)))
        if np.isfinite(self._by_noise[run]):
            furthest = normal_beyond(0.5 * ALARM / len(self._prior))
            found = (*found, Statistic(
                'noise of the gyro in the optional states', float(self._by_noise[run]), 0.0,
                BY_NOISE, tests.frames), Statistic(
                'optional states in their initial sigmas', float(self._beside[run]), 0.0,
                furthest, len(self._prior)))
        return tuple(each._replace(since_ns=self._since.get(each.name)) for each in found)

    def size(self, effect: int) -> float:
        """Return the largest number of the size of an effect of the bank that fits best."""
        return float(np.max(np.abs(self._fit(next(iter(self._tests))).p[effect])))

    def explained(self) -> float:
        """Return by how much the best effect raises twice the log likelihood beyond chance."""
        gains = [each.gain - each.high for each in self.statistics()]
        return max([0.0, *gains])

    def variance_factors(self, run: tuple[int, ...] = ()) -> tuple[float, float]:
        """Return how much larger than stated the variances of turn and rest are."""
        return self._tests[run].variance_factors if self._tests[run].frames >= LEAST else (
            1.0, 1.0)

    def limits(self) -> Iterator[tuple[Effect, Array]]:
        """Yield each steady effect and the sizes, one a number, from which on it is found.

        In half of all runs that are like this one so far; infinite where it can not be told.
        """
        fit = self._fit(next(iter(self._tests)))
        for effect in told(np.zeros(len(fit.gain)), self._changes.begun)[STEADY]:
            yield effect, effect.limit(fit, effect.place)

    def step_limits(self, ages_s: Sequence[float]) -> Iterator[tuple[Effect, Array]]:
        """Yield each step and the sizes, (ages, numbers), from which on it is found by an age."""
        fit = self._fit(next(iter(self._tests)))
        for state, effect in enumerate(
                told(np.zeros(len(fit.gain)), self._changes.begun)[STEPS]):
            places = [self._changes.place(state, age_s) for age_s in ages_s]
            yield effect, np.stack([effect.limit(fit, place) for place in places])

    def _fit(self, run: tuple[int, ...] = ()) -> Fit:
        """Return the sizes of the effects that fit best in one run."""
        responses = self._responses
        return arithmetic.fit(responses.s[run], responses.information[run], responses.largest)

    def _effects(self, run: tuple[int, ...], fit: Fit) -> Iterator[Weighed]:
        return weighed(self._responses.E[run].reshape(self._n, -1, WIDTH), self._root[run], fit,
                       self._changes.begun, self._known)
