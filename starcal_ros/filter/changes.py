# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Steps of the bias, the mounting or the camera: when, which, how large, and what then.

Search
------
Every `STRIDE` frames a candidate begins: a step of each of `CHANGING` at that time, whose response
`responses` follows. Of the `SLOTS` newest and oldest so many are kept that their ages grow by a
like factor, so that the cost is constant and a step is dated to a part of its age. A step has
happened where the likelihood ratio of a candidate is beyond chance, all candidates so far counted,
and no other effect, a drift least of all, explains the innovations as well: `TOLD` in twice the
logarithm of the likelihoods. Likewise a drift. Either is answered where the next look finds one,
too.

Answer
------
With the response E of the errors to the step, its size p and the root of the covariance of that::

    errors <- errors - E p,      root <- [root, E root_p, ...]                         (J.1)

as if the step had been a state from its beginning on (`responses`). It is answered only where
nothing spoke against the model before it. Further columns are the
differences to the neighbouring candidates, for the date, and to the other steps that explain the
innovations as well, for the name. From a drift on its states walk at random, with a density that
covers the drift over the time that it took to be seen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.statistic import ALARM, chi2_beyond
from starcal_ros.core.utc import utc_text
from starcal_ros.filter.hypotheses import CHANGING, DRIFTS, HYPOTHESES, STEP_NUMBERS, STEPS
from starcal_ros.filter.responses import Fit, Responses
from starcal_ros.filter.states import CALIBRATED, SCALE

STRIDE = 20
"""Frames from one candidate to the next: ten seconds at 2 Hz."""
SLOTS = 12
"""Candidates that are kept."""
TOLD = 12.0
"""Difference in twice the logarithm of the likelihood by which one effect is told from another."""

_RIVAL = 0.5            # of the best gain, for another turn to be a rival after a loss
_TURNS = range(3)       # of CHANGING, all but the camera

START, CLEAN, AFRESH = range(3)
"""Of a candidate: its stamp, whether nothing spoke against the model then, and whether the
attitude was found afresh since."""
COUNTED, BEGUN, AWAITED, SINCE = range(4)
"""Number of frames and of candidates so far, whether something was found that a second look is to
confirm, and the stamp of the first frame."""

N_EFFECTS = len(CHANGING) * SLOTS

_FIRST = len(HYPOTHESES)        # effect of the first candidate


class ModelChange(NamedTuple):
    """A change that was found.

    Attributes
    ----------
    kind : str
        ``step`` or ``drift``.
    what : tuple of str
        Out of CHANGING; more than one where they can not be told apart, the likeliest first.
    since_ns : int
        When it happened or, of a drift, from when on its states walk.
    within_s : float
        How well that is known.
    found_ns : int
        When it was found.
    numbers : tuple of str
        What changed, with its unit.
    size, sigma : tuple of float
        By how much, and its standard deviation.
    """

    kind: str
    what: tuple[str, ...]
    since_ns: int
    within_s: float
    found_ns: int
    numbers: tuple[str, ...]
    size: tuple[float, ...]
    sigma: tuple[float, ...]

    @property
    def sentence(self) -> str:
        """What happened."""
        sizes = ', '.join(f'{name} {size:+.4g} +- {sigma:.2g}' for name, size, sigma in zip(
            self.numbers, self.size, self.sigma) if np.isfinite(sigma))
        when = (f'at {utc_text(self.since_ns)} (to {self.within_s:.0f} s)' if self.kind == 'step'
                else f'seen at {utc_text(self.found_ns)}')
        return f'{self.kind} of the {" or ".join(self.what)} {when}: {sizes}'


class Answer(NamedTuple):
    """What follows for the filter.

    Attributes
    ----------
    change : ModelChange
    error : (n,) array
        By which the scaled states are off.
    columns : (n, k) array
        To be joined to the root of their covariance.
    density : (13,) array
        Random walk of the calibrated states from now on, in units of SCALE per root second.
    """

    change: ModelChange
    error: Array
    columns: Array
    density: Array


class Changes:
    """The candidates of one run, or of all runs of a batch.

    Attributes
    ----------
    slots : (SLOTS, 3) int64 array
        START, CLEAN and AFRESH of each candidate that is kept.
    counts : (4,) int64 array
        COUNTED, BEGUN, AWAITED and SINCE.
    """

    def __init__(self) -> None:
        self.slots, self.counts = np.zeros((SLOTS, 3), np.int64), np.zeros(4, np.int64)

    def due(self, stamp_ns: int) -> bool:
        """Count a frame, and say whether a candidate is to begin after it.

        The first frame begins none, as it is none of a window of the tests: it tells nothing of
        the time before it.
        """
        counts = self.counts
        if counts[COUNTED] == 0:
            counts[SINCE] = stamp_ns
        counts[COUNTED] += 1
        return bool(counts[COUNTED] > 1 and counts[COUNTED] % STRIDE == 1)

    @property
    def begun(self) -> int:
        """Number of candidates so far."""
        return int(self.counts[BEGUN])

    @property
    def awaited(self) -> bool:
        """Whether something was found that a second look is to confirm."""
        return bool(self.counts[AWAITED])

    @property
    def _starts(self) -> Ints:
        """Stamps of the candidates that are kept."""
        return self.slots[:self.begun, START]

    def found(self) -> None:
        """Know that the attitude was found afresh."""
        self.slots[:self.begun, AFRESH] = True

    def begin(self, stamp_ns: int, clean: bool, responses: Responses) -> None:
        """Let a candidate begin.

        Parameters
        ----------
        stamp_ns : int
        clean : bool
            Whether nothing speaks against the model so far.
        responses : Responses
        """
        slot = self.begun if self.begun < SLOTS else self._dispensable(stamp_ns)
        self.slots[slot] = stamp_ns, clean, False
        self.counts[BEGUN] += 1
        n = responses.E.shape[-2]
        for k, step in enumerate(STEPS):
            E = np.zeros((n, step.shape[-1]))
            E[:len(step)] = -step               # an error is the estimate less the truth
            responses.begin(_FIRST + slot * len(CHANGING) + k, E)

    def _dispensable(self, now_ns: int) -> int:
        """Return the slot whose neighbours are nearest to each other, for their age."""
        order = np.argsort(self._starts)
        starts = self._starts.astype(np.float64)[order]
        between = (starts[2:] - starts[:-2]) / (now_ns - starts[1:-1])
        return int(order[1 + int(np.argmin(between))])

    def place(self, state: int, age_s: float) -> int:
        """Return the effect that is a step of a state, the candidate nearest to an age."""
        starts = self._starts.astype(np.float64)
        ages = 1e-9 * (starts.max(initial=0.0) - starts)
        slot = int(np.argmin(np.abs(ages - age_s))) if len(ages) else 0
        return _FIRST + slot * len(CHANGING) + state

    def find(self, now_ns: int, fit: Fit, responses: Responses, noise_as_stated: bool
             ) -> Answer | None:
        """Return what has changed and what follows; None for nothing that can be told.

        It is told at the second look in a row: a step may just have happened, and what began long
        before it explain a single frame as well as anything. Noise that is not as it is stated
        may look like a drift.
        """
        found = self._told(now_ns, fit, responses, noise_as_stated)
        confirmed = self.awaited
        self.counts[AWAITED] = found is not None
        return found if confirmed else None

    def _told(self, now_ns: int, fit: Fit, responses: Responses, noise_as_stated: bool
              ) -> Answer | None:
        if not self.begun:
            return None
        gain, known = fit.gain[_FIRST:], len(self._starts) * len(CHANGING)
        gain = np.where(np.arange(len(gain)) < known, gain, 0.0)
        best = int(np.argmax(gain))
        drift = DRIFTS.start + int(np.argmax(fit.gain[DRIFTS]))
        steady = np.delete(fit.gain[:_FIRST], np.arange(DRIFTS.start, DRIFTS.stop)).max()
        rival = max(steady, float(fit.gain[drift]))
        if gain[best] > _limit(int(fit.freedom[_FIRST + best]), self.begun) and (
                gain[best] > rival + TOLD) and self.slots[best // len(CHANGING), CLEAN]:
            return self._step(best, now_ns, gain, fit, responses)
        rival = max(steady, float(gain[best]))
        if noise_as_stated and fit.gain[drift] > _limit(int(fit.freedom[drift]), 1) and (
                fit.gain[drift] > rival + TOLD):
            return self._drift(drift, now_ns, fit, responses)
        return None

    def _step(self, best: int, now_ns: int, gain: Array, fit: Fit, responses: Responses) -> Answer:
        slot, state = divmod(best, len(CHANGING))
        moved = self._moved(best, fit, responses)
        columns = [responses.of(_FIRST + best) @ fit.root[_FIRST + best]]
        order = np.argsort(self._starts).tolist()
        place = order.index(slot)
        beside = [order[k] for k in (place - 1, place + 1) if 0 <= k < len(order)]
        for other in beside:
            other_date = self._moved(other * len(CHANGING) + state, fit, responses)
            columns.append(0.5 * (moved - other_date)[:, None])
        # Where a turn was so large that the attitude was lost, the responses, of first order,
        # fit the better the less they turn: the true one need not gain most.
        share = _RIVAL if self.slots[slot, AFRESH] else 1.0
        what = [CHANGING[state]]
        for other in range(len(CHANGING)):
            rival = slot * len(CHANGING) + other
            least = (share if other in _TURNS else 1.0) * gain[best]
            if other != state and gain[rival] > least - TOLD:
                what.append(CHANGING[other])
                columns += [responses.of(_FIRST + rival) @ fit.root[_FIRST + rival],
                            (moved - self._moved(rival, fit, responses))[:, None]]
        since_ns = int(self._starts[slot])
        within = [abs(since_ns - int(self._starts[other])) for other in beside]
        size, sigma = fit.p[_FIRST + best], fit.sigma[_FIRST + best]
        change = ModelChange(
            'step', tuple(what), since_ns, 1e-9 * max(within, default=0), now_ns,
            STEP_NUMBERS[state], tuple(size.tolist()), tuple(sigma.tolist()))
        return Answer(change, moved, np.concatenate(columns, axis=-1), np.zeros(len(SCALE) - 3))

    @staticmethod
    def _moved(candidate: int, fit: Fit, responses: Responses) -> Array:
        """Return by how much a step of the size that fits has moved the errors, (n,)."""
        moved: Array = responses.of(_FIRST + candidate) @ fit.p[_FIRST + candidate]
        return moved

    def _drift(self, drift: int, now_ns: int, fit: Fit, responses: Responses) -> Answer:
        state = drift - DRIFTS.start
        moved = responses.of(drift) @ fit.p[drift]
        since_ns = int(self.counts[SINCE])
        elapsed_s = 1e-9 * max(now_ns - since_ns, 1)
        # Over the time that it took, the walk covers what the drift did in it.
        rate = np.abs(STEPS[state][CALIBRATED] @ fit.p[drift]) / 3600.0
        change = ModelChange(
            'drift', (CHANGING[state],), since_ns, 0.0, now_ns, HYPOTHESES[drift].numbers,
            tuple(fit.p[drift].tolist()), tuple(fit.sigma[drift].tolist()))
        return Answer(change, moved, np.concatenate(
            (responses.of(drift) @ fit.root[drift], moved[:, None]), axis=-1),
            rate * np.sqrt(elapsed_s))


def _limit(freedom: int, tried: int) -> float:
    """Return the gain that chance exceeds with the probability ALARM, of all that were tried."""
    return chi2_beyond(ALARM / (len(CHANGING) * max(tried, 1)), max(freedom, 1))
