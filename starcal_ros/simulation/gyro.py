# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gyro triad: true increments, scale, bias and angular random walk.

Model
-----
::

    omega_m = ((I + M) theta + b dt + N sqrt(dt) n) / dt,    n ~ N(0, I)       (G.1)

    theta   (3,)    rad            turn of g over the interval, from the true attitude at its ends
    M       (3, 3)  1              scale factors and misalignment (`gyro_scale`)
    b       (3,)    rad/s          bias in the middle of the interval (`bias_walk`)
    N               rad/sqrt(s)    angular random walk
    dt              s              sampling interval; a reading is stamped at its end

``theta`` is the logarithm of the true rotation over the interval, which for a rotation about one
axis, as in T18 Table 2, is the integral of the true rate: nothing is lost between samples. M and
the walk of b are two of the `errors`: their hooks `bias`, `rate` and `readings` are called here.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Ints
from starcal_ros.core.units import DEG_PER_SQRT_HOUR, NS
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.simulation.errors import switched_on
from starcal_ros.simulation.motion import turns
from starcal_ros.simulation.truth import Truth


class GyroSimulator:
    """The readings of one run, in order, in batches of any size.

    Parameters
    ----------
    scenario : Scenario
        Rate, noise, duration and start.
    truth : Truth
        What the gyros feel.
    rng : np.random.Generator
        The sensor's own stream; a run is the same to the bit however it is cut into batches.
    """

    def __init__(self, scenario: Scenario, truth: Truth, rng: np.random.Generator) -> None:
        self.count = int(scenario.simulation.duration_s * scenario.gyro.rate_hz + 1e-6)
        self.next_index = 0
        self._period_ns = 1e9 / scenario.gyro.rate_hz
        self._stated_walk = scenario.gyro.arw_deg_sqrt_h * DEG_PER_SQRT_HOUR
        walk = scenario.truth.gyro.arw_deg_sqrt_h
        self._walk = self._stated_walk if walk is None else walk * DEG_PER_SQRT_HOUR
        self._on_rate = switched_on('rate', scenario)
        self._on_readings = switched_on('readings', scenario)
        self._truth = truth
        self._rng = rng

    @property
    def rate_variance(self) -> float:
        """Variance of the noise of a reading, each axis, as believed [rad^2/s^2]."""
        return self._stated_walk**2 / (self._period_ns * NS)

    def stamp_ns(self, index: np.typing.ArrayLike) -> Ints:
        """Return the stamp of the reading with an index from 0: the end of its interval."""
        steps = np.rint((np.asarray(index) + 1) * self._period_ns).astype(np.int64)
        return self._truth.motion.start_ns + steps

    def next(self, count: int) -> GyroSamples:
        """Return the next readings: `count` of them, fewer at the end of the run."""
        stop = min(self.next_index + count, self.count)
        stamps = self.stamp_ns(np.arange(self.next_index - 1, stop))
        self.next_index = stop
        theta = turns(self._truth.motion, stamps)
        dt = np.diff(stamps)[:, None] * NS
        noise = self._rng.standard_normal(theta.shape)
        rate = theta / dt
        for sense in self._on_rate:
            rate = sense(stamps[1:], rate)
        bias = self._truth.bias_at((stamps[:-1] + stamps[1:]) // 2)
        samples = GyroSamples(stamps[1:], rate + bias + self._walk / np.sqrt(dt) * noise)
        for spoil in self._on_readings:
            samples = spoil(samples)
        return samples
