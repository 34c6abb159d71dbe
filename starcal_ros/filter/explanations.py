# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which extension of the model explains data that contradict it.

Those extensions are tried to which the tests that fail point (`candidates`). All run over the same
stretch of the messages, the first at which the tests fail of `STRETCHES_S`, and are ranked by
twice the logarithm of the likelihood that they add (`likelihood`) less ``k ln n``, k the numbers
that they add to the model and n the frames: Schwarz, *Estimating the dimension of a model*, The
Annals of Statistics 6(2), 1978.

An extension explains the data where its likelihood ratio is beyond chance: chi-square of k degrees
of freedom, `ALARM` for all that were tried. One that adds to another has to be better than that
beyond chance, too. The best is told from the others where it is better by `TOLD`. Of those that
are as good all are said, and none is adopted, unless they are equal in effect: no state moves by
more than `ALIKE` of its sigma from one to the other, and no sigma by more than a tenth.

Where tests fail still under the best cause, those to which they point are tried on top of it, up
to `MOST` together: what is wrong may be two things. A larger noise covers much that has a cause:
it is built on where no cause explains anything, and of those that are best together each is left
out once, too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.statistic import ALARM, chi2_beyond
from starcal_ros.filter import message_pass
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.candidates import ADAPT, Candidate, pointed, rounded
from starcal_ros.filter.changes import TOLD
from starcal_ros.filter.noise import Noise
from starcal_ros.filter.noise_levels import NoiseLevel
from starcal_ros.filter.noise_search import Search
from starcal_ros.filter.states import CALIBRATED
from starcal_ros.measurements.message_source import InMemory, MessageSource, about, extent
from starcal_ros.measurements.samples import Frames

STRETCHES_S = (900.0, 3600.0)
"""Parts of the recording that extensions are tried on: the first that is long enough [s]."""
ALIKE = 0.5
"""Shift of a state, in its sigmas, that makes no difference."""

MOST = 3
"""Extensions that are tried together, at most."""
_SIGMA = 1.1                            # ratio of two sigmas that makes no difference


class Tried(NamedTuple):
    """An extension that was tried.

    Attributes
    ----------
    name : str
    values : mapping
        Parameters to add.
    numbers : int
        k.
    gain : float
        What it adds to twice the logarithm of the likelihood.
    score : float
        The same less k ln n.
    beyond_chance : bool
        Whether its likelihood ratio is.
    """

    name: str
    values: Mapping[str, Any]
    numbers: int
    gain: float
    score: float
    beyond_chance: bool

    @property
    def lines(self) -> tuple[str, ...]:
        """What to add to the parameter file, one parameter a line."""
        return tuple(f'{key}: {_yaml(value)}' for key, value in self.values.items())


@dataclass(frozen=True)
class Explanations:
    """What would explain the data.

    Attributes
    ----------
    tried : tuple of Tried
        The best first.
    best : tuple of Tried
        Those that can not be told apart as the best; none where nothing explains the data.
    alike : bool
        Whether these are equal in effect.
    stretch_s : float
        Length of what they were tried on.
    """

    tried: tuple[Tried, ...]
    best: tuple[Tried, ...]
    alike: bool
    stretch_s: float

    @property
    def to_adopt(self) -> Tried | None:
        """The extension that may be adopted, of those that are equal in effect the simplest."""
        if not self.best or (len(self.best) > 1 and not self.alike):
            return None
        return min(self.best, key=lambda each: (each.numbers, -each.score))

    @property
    def sentence(self) -> str:
        """What was found."""
        if not self.tried:
            return 'no extension of the model is known for what fails'
        if not self.best:
            return 'no extension of the model explains the data better than chance would'
        names = [each.name for each in self.best]
        if len(names) == 1:
            return f'best explained by: {names[0]}'
        return f'explained as well by: {"; ".join(names)}; ' + (
            'equal in effect' if self.alike else 'the data do not tell them apart')


def explain(source: MessageSource, scenario: Scenario, calibrated: Calibrator,
            covariance: Array | None = None,
            on_progress: Callable[[float], None] = lambda part: None) -> Explanations:
    """Try the extensions to which the tests of a calibration point.

    Parameters
    ----------
    source : MessageSource
        All the messages.
    scenario : Scenario
        What it was calibrated with.
    calibrated : Calibrator
        After all the messages; some of its tests fail.
    covariance : (13, 13) array, optional
        Of the error of the nominal values, in place of the initial sigmas.
    on_progress : callable
        Called now and then with the part done, 0 to 1.
    """
    statistics = calibrated.consistency.statistics()
    candidates = list(pointed(statistics, scenario, calibrated.consistency))
    if not candidates:
        return Explanations((), (), False, 0.0)
    since = [each.since_ns for each in statistics if each.since_ns is not None]
    whole = extent(source)
    for seconds in STRETCHES_S:
        part = about(source, whole, seconds, min(since, default=calibrated.stamp_ns))
        base = _run(part, scenario, covariance)
        if len(part.frames) == whole.frames or not all(
                each.passed for each in base.consistency.statistics()):
            break

    trials = _Trials(part, scenario, covariance, base)
    together: tuple[Candidate, ...] = ()
    for step in range(MOST):
        trials.levels |= {key for each in candidates if each.values.get(ADAPT)
                          for key in each.sought}
        for k, candidate in enumerate(candidates):
            trials.attempt((*together, candidate))
            on_progress((step + (k + 1) / len(candidates)) / (MOST + 1))
        base_of_more = trials.to_build_on(together)
        if base_of_more is None:
            break
        together = base_of_more.parts
        tests = base_of_more.run.consistency
        candidates = [each for each in pointed(
            tests.statistics(), scenario.replace(base_of_more.tried.values), tests)
            if each.name not in {one.name for one in together}]
    for each in together if len(together) > 1 else ():
        trials.attempt(tuple(other for other in together if other is not each))
    on_progress(1.0)
    best = trials.best()
    return Explanations(tuple(each.tried for each in trials.found),
                        tuple(each.tried for each in best), _alike([each.run for each in best]),
                        float(frames_s(part.frames)))


class _Attempt(NamedTuple):
    """Some extensions together, what came of them, and the calibrator that had them."""

    parts: tuple[Candidate, ...]
    tried: Tried
    run: Calibrator


class _Trials:
    """What was tried on a stretch of the messages, the best first."""

    def __init__(self, part: InMemory, scenario: Scenario, covariance: Array | None,
                 base: Calibrator) -> None:
        self._part, self._scenario, self._covariance = part, scenario, covariance
        self._base = base
        self._sought: dict[frozenset[tuple[str, Any]], Sequence[NoiseLevel]] = {}
        self.levels: set[str] = set()                   # that any of those that are tried asks for
        self.found: list[_Attempt] = []

    def attempt(self, parts: tuple[Candidate, ...]) -> None:
        """Try some extensions together; what was tried already is not tried again."""
        name = ' and '.join(sorted(each.name for each in parts))
        if name in {each.tried.name for each in self.found}:
            return
        values = {key: value for each in parts for key, value in each.values.items()
                  if key != ADAPT}
        walks = [key for each in parts if not each.values for key in each.sought]
        if walks:
            search = Search(self._part, self._scenario.replace(values), walks, self._covariance,
                            brief=True)
            values |= {key: rounded(value) for key, value in search.values.items()}
        noises = [key for each in parts if each.values.get(ADAPT) for key in each.sought]
        # What is sought is found already: the run itself has it as given.
        run = _run(self._part, self._scenario.replace(values), self._covariance, [
            each for each in self._found_levels(values) if each.key in noises] if noises else ())
        if noises:
            values[ADAPT] = (*self._scenario.estimator.adapt, *noises)
        gain = float(run.consistency.likelihood.twice_log
                     - self._base.consistency.likelihood.twice_log)
        numbers = sum(each.numbers for each in parts)
        score = gain - numbers * math.log(max(len(self._part.frames), 2))
        self.found.append(_Attempt(parts, Tried(name, values, numbers, gain, score, False), run))
        self.found.sort(key=lambda each: -each.tried.score)

    def best(self) -> tuple[_Attempt, ...]:
        """Return the best of those that explain the data and what can not be told from it."""
        count = len(self.found)
        self.found = [each._replace(tried=each.tried._replace(
            beyond_chance=each.tried.gain > chi2_beyond(ALARM / count, each.tried.numbers)))
            for each in self.found]
        best = _best([each.tried for each in self.found], count)
        return tuple(each for each in self.found if each.tried in best)

    def to_build_on(self, together: tuple[Candidate, ...]) -> _Attempt | None:
        """Return what more is to be tried on top of; None for nothing.

        The best cause that goes on from what was built on: a larger noise covers two causes better
        than each of them alone explains the data. Where there is none the best, if it is told from
        all others.
        """
        best = self.best()
        causes = [each for each in self.found if each.tried.beyond_chance
                  and each.parts != together and each.parts[:len(together)] == together
                  and all(part.is_cause for part in each.parts)]
        if causes:
            return causes[0]
        return best[0] if len(best) == 1 and best[0].parts != together else None

    def _found_levels(self, values: Mapping[str, Any]) -> Sequence[NoiseLevel]:
        """Return the noise levels, sought once for what else is tried."""
        key = frozenset(values.items())
        if key not in self._sought:
            self._sought[key] = Search(self._part, self._scenario.replace(values),
                                       sorted(self.levels), self._covariance).found()
        return self._sought[key]


def frames_s(frames: Frames) -> float:
    """Return the time from the first frame to the last [s]."""
    return (int(frames.stamp_ns[-1]) - int(frames.stamp_ns[0])) * 1e-9 if len(frames) else 0.0


def _run(part: MessageSource, scenario: Scenario, covariance: Array | None,
         levels: Sequence[NoiseLevel] = ()) -> Calibrator:
    calibrator = Calibrator(scenario, covariance, Noise(scenario, levels))
    for _ in message_pass.run(calibrator, part):
        pass
    return calibrator


def _best(tried: Sequence[Tried], count: int) -> tuple[Tried, ...]:
    """Return the best of those that explain the data and what can not be told from it."""
    found = [each for each in tried if each.beyond_chance and not any(
        _adds_to(each, other) and each.gain - other.gain <= chi2_beyond(
            ALARM / count, each.numbers - other.numbers) for other in tried)]
    return tuple(each for each in found if each.score > found[0].score - TOLD)


def _adds_to(one: Tried, other: Tried) -> bool:
    """Tell whether an extension has all that another has, and more."""
    def parts(each: Tried) -> set[str]:
        return {*each.values.get(ADAPT, ()), *each.values} - {ADAPT}
    return parts(one) > parts(other)


def _alike(runs: Sequence[Calibrator]) -> bool:
    """Tell whether some calibrations have the same estimates and sigmas."""
    beliefs = [run.belief for run in runs]
    return all(one is not None and beliefs[0] is not None and _equal(one, beliefs[0])
               for one in beliefs[1:])


def _equal(one: Belief, other: Belief) -> bool:
    x, y = one.estimate, other.estimate
    shift = np.concatenate((x.bias - y.bias, rotation.log(x.C_sg @ y.C_sg.T),
                            x.intrinsics - y.intrinsics))
    a, b = one.sigma[CALIBRATED], other.sigma[CALIBRATED]
    return bool((np.abs(shift) < ALIKE * np.minimum(a, b)).all()
                and (np.maximum(a / b, b / a) < _SIGMA).all())


def _yaml(value: Any) -> str:
    if isinstance(value, tuple):
        return f'[{", ".join(value)}]'
    # ROS 2 takes 1e-05 for a text: a number has a point.
    text = repr(value)
    return text if '.' in text or 'e' not in text else text.replace('e', '.0e')
