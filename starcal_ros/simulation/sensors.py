# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulated sensors of a scenario, each with its own stream of randomness."""

from __future__ import annotations

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.simulation.gyro import GyroSimulator
from starcal_ros.simulation.randomness import stream
from starcal_ros.simulation.render import ImageSimulator
from starcal_ros.simulation.star_tracker import StarTrackerSimulator
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky import catalog


def _rng(scenario: Scenario, sensor: int) -> np.random.Generator:
    # A child stream by its number: a process that simulates one sensor need not make the other.
    return np.random.default_rng(np.random.SeedSequence(scenario.simulation.seed,
                                                        spawn_key=(sensor,)))


def star_tracker(scenario: Scenario) -> StarTrackerSimulator:
    """Return the star tracker of a scenario.

    Raises
    ------
    ValueError
        Where the catalogue does not reach down to the limiting magnitude.
    """
    stars = catalog.load(scenario.star_tracker.limiting_magnitude)
    return StarTrackerSimulator(scenario, Truth.from_scenario(scenario), stars, _rng(scenario, 0))


def images(scenario: Scenario) -> ImageSimulator:
    """Return the images of the star tracker: the same truth, and noise of their own.

    Raises
    ------
    ValueError
        Where the catalogue does not reach down to the limiting magnitude of the images.
    """
    stars = catalog.load(scenario.image.limiting_magnitude)
    return ImageSimulator(scenario, scenario.image, Truth.from_scenario(scenario), stars,
                          stream(scenario, 'render'))


def gyro(scenario: Scenario) -> GyroSimulator:
    """Return the gyro of a scenario."""
    return GyroSimulator(scenario, Truth.from_scenario(scenario), _rng(scenario, 1))
