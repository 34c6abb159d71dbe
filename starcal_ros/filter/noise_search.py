# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The noise levels that all the messages of a recording show: scoring, pass by pass.

Each pass runs the calibrator with the levels so far and takes Fisher's step of the scores
(`noise_levels`), first over a stretch of the recording, then over all of it, until a step is small
against what is known. The centroids begin `noise.WIDE` times too wide, so that good stars are not
rejected from the first frame on.

No level is to cover a fault. Steps are answered on the way, whatever the noise tests say, and
windows that contradict the others are left out. In the end the levels are used only if they make
the data likelier than the stated ones do *with the best effect of the bank* (`hypotheses`,
`changes`) taken out on both sides: a time offset that looks like noise of the gyro is named as
what it is, and the stated levels are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.statistic import ALARM, chi2_beyond
from starcal_ros.filter import message_pass
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.noise import WIDE, Noise, begin_value
from starcal_ros.filter.noise_levels import CENTROIDS, NoiseLevel, expected, found, scaled, spread
from starcal_ros.measurements.message_source import MessageSource, beginning, extent

FIRST_S, STRETCH_S = 90.0, 300.0
"""Parts of the recording for the first steps: of the centroids alone, and of all levels [s]."""

_MOST = 8               # steps over one part, at most
_BRIEF = 4              # likewise, where a few will do
_SHARE = 0.2            # of the time that one pass over all takes
_COARSE = 0.1           # of ln theta: from here on more of the recording is worth its time
_SMALL = 0.5            # step, in sigmas, that is none
_LEAST = 0.01           # of ln theta: likewise


class _Pass:
    """One run over some messages."""

    def __init__(self, source: MessageSource, scenario: Scenario,
                 covariance: Array | None, levels: Sequence[NoiseLevel], sought: bool,
                 on_progress: Callable[[float], None]) -> None:
        calibrator = Calibrator(scenario, covariance, Noise(scenario, levels, sought))
        for _ in message_pass.run(calibrator, source, on_progress):
            pass
        counts = calibrator.counts
        self.lost = counts.stars <= counts.rejected_stars
        self.tests = calibrator.consistency
        # The best effect is taken out: noise is what remains.
        self.explained = float(self.tests.likelihood.twice_log) + self.tests.explained()


class Search:
    """The levels of some messages, pass by pass.

    Parameters
    ----------
    source : MessageSource
        All the messages.
    scenario : Scenario
    keys : sequence of str
        Parameters of the levels.
    covariance : (13, 13) array, optional
        Of the error of the nominal values, in place of the initial sigmas.
    on_progress : callable
        Called now and then with the part done, 0 to 1.
    brief : bool
        A few passes over all of the messages will do.

    Attributes
    ----------
    values : dict
        What the data say, by parameter.
    """

    def __init__(self, source: MessageSource, scenario: Scenario, keys: Sequence[str],
                 covariance: Array | None = None,
                 on_progress: Callable[[float], None] = lambda part: None,
                 brief: bool = False) -> None:
        self._whole, self._keys = source, keys
        self._frames = extent(source).frames
        self._scenario, self._covariance = scenario, covariance
        self._on_progress, self._done = on_progress, 0.0
        self._informations = dict.fromkeys(keys, 0.0)
        self.values = {key: begin_value(scenario, key) * (WIDE if key == CENTROIDS else 1.0)
                       for key in keys}
        for seconds, sought in ((FIRST_S, [key for key in keys if key == CENTROIDS]),
                                (STRETCH_S, keys)):
            if not sought or brief:
                continue
            part = beginning(source, seconds)
            if len(part.frames) < self._frames:
                self._approach(part, sought, _COARSE, share=len(part.frames) / self._frames)
        self._last = self._approach(
            source, keys, *((_COARSE, _BRIEF) if brief else (_LEAST, _MOST)))
        self.values = {key: value * expected(self._informations[key])
                       for key, value in self.values.items()}

    def found(self, used: bool = True) -> Sequence[NoiseLevel]:
        """Return the levels."""
        return found(self._scenario, self.values, self._informations, used)

    def better(self) -> bool:
        """Tell whether they explain the data better than the stated ones, beyond chance."""
        # Stars that are all rejected from the beginning take long, and leave no question.
        begun = beginning(self._whole, FIRST_S)
        if self._run(begun, (), False, len(begun.frames) / max(self._frames, 1)).lost:
            return True
        as_stated = self._run(self._whole, (), False, 1.0)
        return (self._last.explained - as_stated.explained
                > chi2_beyond(ALARM, len(self._keys)))

    def _approach(self, part: MessageSource, sought: Sequence[str], small: float,
                  most: int = _MOST, share: float = 1.0) -> _Pass:
        for _ in range(most):
            made = self._run(part, self.found(), True, share)
            assert made.tests.scores is not None
            steps = made.tests.scores.steps()
            far = False
            for key in set(sought) & set(steps):
                factor = scaled(key, *steps[key])
                self.values[key] *= factor
                self._informations[key] = steps[key][1]
                far |= abs(math.log(factor)) > max(
                    small, _SMALL * spread(self._informations[key]))
            if not far:
                break
        return made

    def _run(self, part: MessageSource, levels: Sequence[NoiseLevel], sought: bool,
             share: float) -> _Pass:
        """Run over a part that has a share of all frames."""
        begun, share = self._done, _SHARE * share
        made = _Pass(part, self._scenario, self._covariance, levels, sought,
                     lambda part: self._on_progress(min(begun + share * part, 1.0)))
        self._done += share
        return made


def levels(source: MessageSource, scenario: Scenario, covariance: Array | None = None,
           on_progress: Callable[[float], None] = lambda part: None) -> Sequence[NoiseLevel]:
    """Return the levels of ``estimator.adapt``, to be used where they are better (`Search`)."""
    search = Search(source, scenario, scenario.estimator.adapt, covariance, on_progress)
    return search.found(search.better())
