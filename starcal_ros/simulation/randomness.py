# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Randomness: a stream of its own for each sensor and each error source.

All streams descend from the seed of the run (numpy's ``SeedSequence``) by the name of what draws
from them. So two sensors that are started apart meet the same errors, and an error that is
switched on leaves the noise and the other errors as they were.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.config.scenario import Scenario


def stream(scenario: Scenario, source: str) -> np.random.Generator:
    """Return the stream of an error source, which goes by the name of its module."""
    key = tuple(source.encode())
    return np.random.default_rng(np.random.SeedSequence(scenario.simulation.seed, spawn_key=key))
