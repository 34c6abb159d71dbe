# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Misidentified stars: spots that carry the number of another star.

Model
-----
Each identified star is, with the probability ``truth.star_tracker.misidentified_fraction`` and
whatever happened to the others, taken for the star of the catalogue that is nearest to it in the
sky, down to the limiting magnitude: an identifier confuses what lies close together. That one may
be in the field as well; then two spots of the frame carry its number.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from starcal_ros.config.parameter import ConfigError, Spec
from starcal_ros.config.scenario import Scenario
from starcal_ros.measurements.samples import Frames
from starcal_ros.simulation.randomness import stream

if TYPE_CHECKING:
    from starcal_ros.sky.catalog import Catalog

GROUP = 'star_tracker'
ORDER = 70
ON = {'1 % wrong': {'misidentified_fraction': 0.01}}
NOTE = 'wrong: stars with the number of their neighbour.'


@dataclass(frozen=True)
class Config:
    """How often it happens."""

    misidentified_fraction: Annotated[float, Spec(
        "Part of the stars that get their nearest neighbour's number (misidentification)",
        '', 0.0, 1.0)] = 0.0


def frames(scenario: Scenario, stars: Catalog) -> Callable[[Frames], Frames] | None:
    """Return the function that confuses stars of frames, or None where it is off."""
    if scenario.truth.of(Config).misidentified_fraction == 0.0:
        return None
    return Misidentification(scenario, stars).confuse


class Misidentification:
    """The identifier's mistakes in one run, in order.

    Parameters
    ----------
    scenario : Scenario
        Its fraction and seed.
    stars : Catalog
        The stars that may be taken for each other.

    Raises
    ------
    ConfigError
        Where there are fewer than two of them.
    """

    def __init__(self, scenario: Scenario, stars: Catalog) -> None:
        import erfa
        from scipy.spatial import cKDTree
        self._fraction = scenario.truth.of(Config).misidentified_fraction
        if len(stars) < 2:
            raise ConfigError(f'truth.star_tracker.misidentified_fraction: got {self._fraction} '
                              f'with {len(stars)} stars in the whole sky, needs 2')
        self._rng = stream(scenario, 'misidentification')
        self._stars = stars
        direction = erfa.s2c(stars.ra, stars.dec)
        self._neighbour = cKDTree(direction).query(direction, k=2)[1][:, 1]

    def confuse(self, frames: Frames) -> Frames:
        """Return the next frames of the run with some of their stars misidentified."""
        wrong = self._rng.random(len(frames.catalog_id)) < self._fraction
        hip = frames.catalog_id.copy()
        hip[wrong] = self._stars.hip[self._neighbour[self._stars.rows(hip[wrong])]]
        return dataclasses.replace(frames, catalog_id=hip)
