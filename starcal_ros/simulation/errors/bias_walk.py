# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bias random walk: the gyro bias after the start of the run.

Model
-----
::

    b(t) = b(0) + K w(t),    w a standard Wiener process                       (G.3)

    K    rad/s/sqrt(s)    random walk of the bias; sigma of b(t) - b(0) is K sqrt(t)

(Farrenkopf, Journal of Guidance and Control 1(4), 1978). It is drawn once a second and linear
between. What that leaves out of a second, K sqrt(1 s), is far below the noise of a reading.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from starcal_ros.config.parameter import Spec
from starcal_ros.config.scenario import Scenario, stamp_ns
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import DEG_PER_HOUR
from starcal_ros.simulation.process import Process
from starcal_ros.simulation.randomness import stream

GROUP = 'gyro'
ORDER = 20
ON = {'bias walk': {'bias_random_walk_deg_h_sqrt_h': 0.01}}
NOTE = 'bias walk: 0.01 deg/h/sqrt(h), errors from the bias at the end.'

_STEP = 1.0                                     # s
_DEG_PER_HOUR_PER_SQRT_HOUR = DEG_PER_HOUR / 60.0       # rad/s/sqrt(s)


@dataclass(frozen=True)
class Config:
    """How the bias walks."""

    bias_random_walk_deg_h_sqrt_h: Annotated[float, Spec(
        'Random walk of the bias of each gyro, 0 is off (bias_walk)', 'deg/h/sqrt(h)', 0.0, 1e6)
    ] = 0.0


def bias(scenario: Scenario) -> Callable[[Ints], Array] | None:
    """Return b(t) - b(0) [rad/s], or None where it is off."""
    K = scenario.truth.of(Config).bias_random_walk_deg_h_sqrt_h * _DEG_PER_HOUR_PER_SQRT_HOUR
    if K == 0.0:
        return None
    simulation = scenario.simulation
    count = int(np.ceil(simulation.duration_s / _STEP))
    n = stream(scenario, 'bias_walk').standard_normal((count, 3))
    w = np.sqrt(_STEP) * np.concatenate((np.zeros((1, 3)), np.cumsum(n, axis=0)))
    return Process(stamp_ns('simulation.start_utc', simulation.start_utc), _STEP, K * w).at
