# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which noise levels a calibrator goes by: stated ones, those that were found, or its own.

Whoever has all the messages seeks the levels in several passes (`noise_search`) and gives them.
A live estimator has one pass, and no way back from a covariance that was too small. It estimates
the sigma of the centroids and the random walk of the gyros: they begin `WIDE` times as large as
stated and come down, whenever the scores of the windows since the last time (`noise_levels`) say
beyond doubt that a level is smaller, to the upper end of what they leave; that of the gyros when
the centroids have come to rest, since against stars that are thought worse than they are any gyro
looks good. No level rises: what looks like more noise later on may be a fault, which is for the
tests to find. These begin afresh with each new level, and a window has to leave all levels as they
are before they say anything of noise. The walks of the states show only after hours, in which a
level that is wrong has already shaped the covariance: they are believed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

from starcal_ros.config.estimator import EstimatorConfig
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.units import DEG_PER_SQRT_HOUR
from starcal_ros.filter.error_state import Filter
from starcal_ros.core.statistic import gated_nis
from starcal_ros.filter.model_tests import ModelTests
from starcal_ros.filter.noise_levels import (CENTROIDS, GYRO, NoiseLevel, Scores, found, scaled,
                                             sigma_factor, stated, with_levels)
from starcal_ros.measurements.samples import Stars

WIDE = 10.0
"""Times the stated level with which the search for it begins."""

_LOWERED = 1.1          # a tenth of a sigma is of no account
_DOUBT = 3.0            # sigmas that are left above


class Noise:
    """Levels that are given: those of the scenario, but for some.

    Parameters
    ----------
    scenario : Scenario
    levels : sequence of NoiseLevel
        Those that were found.
    sought : bool
        Whether they are still sought: they are scored, and need not be right.

    Attributes
    ----------
    factor : float
        By which the sigma of each star is multiplied.
    """

    def __init__(self, scenario: Scenario, levels: Sequence[NoiseLevel] = (), sought: bool = False
                 ) -> None:
        self._scenario, self._given = scenario, tuple(levels)
        self._sought = sought
        self._values: dict[str, float] = {}
        self.begin()

    @property
    def known(self) -> bool:
        """Whether what the levels promise is to be held against the model."""
        return not self._sought

    @property
    def notices(self) -> list[str]:
        """What a user should know from the beginning."""
        return []

    def begin(self) -> None:
        """Know that all begins, or begins again."""
        self._set({each.key: each.value for each in self._given if each.used})

    def levels(self) -> Sequence[NoiseLevel]:
        """Return the levels that were estimated."""
        return self._given

    def scores(self, filter_: Filter, options: EstimatorConfig) -> Scores | None:
        """Return what is to be told of the frames; None for nothing."""
        if not self._sought:
            return None
        return Scores(self._values, filter_.scale, gated_nis(options.gate_probability))

    def stated_in(self, scenario: Scenario) -> Scenario:
        """Return a scenario with these levels."""
        return with_levels(scenario, self._values) if self._values else scenario

    def of_stars(self, stars: Stars) -> Stars:
        """Return the stars of a frame with the sigmas that they have."""
        if self.factor == 1.0:
            return stars
        return stars._replace(sigma=stars.sigma * self.factor)

    def settle(self, tests: ModelTests) -> bool:
        """Tell after a frame whether the levels are others from now on."""
        return False

    def _set(self, values: Mapping[str, float]) -> None:
        self._values = dict(values)
        self.factor = sigma_factor(self._scenario, values)


class ComingDown(Noise):
    """The levels of a single pass, from above.

    Parameters
    ----------
    scenario : Scenario
        With levels in ``estimator.adapt``.
    """

    def __init__(self, scenario: Scenario) -> None:
        # In the order in which they are to come to rest.
        self._keys = [key for key in (CENTROIDS, GYRO) if key in scenario.estimator.adapt]
        super().__init__(scenario, sought=True)

    @property
    def notices(self) -> list[str]:
        """Which levels a single pass leaves as they are stated."""
        return [f'{key} of estimator.adapt is estimated by starcal calibrate alone: live, the '
                'stated one holds'
                for key in self._scenario.estimator.adapt if key not in self._keys]

    def begin(self) -> None:
        """Know that all begins, or begins again."""
        self._informations: dict[str, float] = {}
        self._settled, self._windows = not self._keys, 0
        self._set({key: WIDE * begin_value(self._scenario, key) for key in self._keys})

    @property
    def known(self) -> bool:
        """Whether the last window has left the levels as they were."""
        return self._settled

    def levels(self) -> Sequence[NoiseLevel]:
        """Return the levels as they are now."""
        return found(self._scenario, self._values, self._informations)

    def settle(self, tests: ModelTests) -> bool:
        """Lower the levels at the end of a window; tell whether one was."""
        scores = tests.scores
        assert scores is not None
        if len(scores.windows) == self._windows:
            return False
        values, lowered = dict(self._values), False
        steps = scores.steps()
        for key in self._keys:
            step, information = steps[key]
            self._informations[key] = information
            if information > 0.0:
                factor = scaled(key, step + _DOUBT / math.sqrt(information), information)
                lowered = factor < 1.0 / _LOWERED
                if lowered:
                    values[key] *= factor
                    break
        self._settled, self._windows = not lowered, len(scores.windows)
        tests.noise_known = self._settled
        if lowered:
            self._set(values)
            scores.levels, self._windows = values, 0
            scores.restart()
            tests.begin()
        return lowered


def begin_value(scenario: Scenario, key: str) -> float:
    """Return what the search for a level begins about: the stated one where there is one.

    A walk that is stated as none begins with one that matters: ten tolerances in an hour, of the
    gyros a turn by the sigma of a centroid from frame to frame.
    """
    if key == GYRO:
        tracker, camera = scenario.star_tracker, scenario.camera
        sigma = tracker.centroid_sigma_px * camera.pixel_pitch_mm / camera.focal_length_mm
        return stated(scenario, key) or sigma * math.sqrt(tracker.rate_hz) / DEG_PER_SQRT_HOUR
    kind = key.rpartition('.')[2].removesuffix('_sqrt_h')
    return stated(scenario, key) or 10.0 * float(getattr(scenario.estimator.tolerance, kind))


def noise_of(scenario: Scenario) -> Noise:
    """Return the levels of a scenario, for a single pass."""
    return ComingDown(scenario) if scenario.estimator.adapt else Noise(scenario)
