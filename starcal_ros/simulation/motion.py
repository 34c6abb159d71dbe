# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""True attitude as a pure function of time: rotations about the gyro axes (T18 Table 2).

Each rotation waits for the dwell time, then turns about one gyro axis with a trapezoidal rate:
constant angular acceleration up to the slew rate, constant rate, the same acceleration down.
After the last rotation the sequence begins again from the attitude reached. Two simulators that
are started apart agree on the attitude because nothing is integrated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from starcal_ros.config.scenario import Scenario, stamp_ns
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.remembered import remembered


@dataclass(frozen=True)
class Motion:
    """One scenario's rotation sequence, ready to be evaluated.

    Attributes
    ----------
    start_ns : int
        Stamp of t = 0.
    begin : (n + 1,) array
        Time at which each step (dwell and rotation) begins, and the length of the cycle [s].
    dwell : float
        Rest at the beginning of a step [s].
    axis : (n, 3) array
        Unit vector of each rotation, in g.
    angle : (n,) array
        Angle of each rotation [rad].
    acceleration, rate : float
        Angular acceleration [rad/s^2] and slew rate [rad/s].
    C_ig : (n, 3, 3) array
        Attitude at the beginning of each step of the first cycle.
    turn : (3,) array
        Rotation vector, in i, that a whole cycle leaves behind.
    """

    start_ns: int
    begin: Array
    dwell: float
    axis: Array
    angle: Array
    acceleration: float
    rate: float
    C_ig: Array
    turn: Array

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> Motion:
        """Build the motion of the groups ``motion`` and ``simulation``."""
        motion = scenario.motion
        axis = np.eye(3)[['xyz'.index(name) for name in motion.axes]]
        angle = np.radians(motion.angles_deg)
        acceleration = np.radians(motion.acceleration_deg_s2)
        rate = np.radians(motion.rate_deg_s)
        start = np.array(motion.initial_quaternion_xyzw)
        C_ig = [rotation.to_matrix(start / np.linalg.norm(start))]
        for step in rotation.exp(axis * angle[:, None]):
            C_ig.append(C_ig[-1] @ step)
        length = motion.dwell_s + _slew_duration(np.abs(angle), rate, acceleration)
        return cls(stamp_ns('simulation.start_utc', scenario.simulation.start_utc),
                   np.concatenate(([0.0], np.cumsum(length))), motion.dwell_s, axis, angle,
                   acceleration, rate, np.stack(C_ig[:-1]),
                   rotation.log(C_ig[-1] @ C_ig[0].T))

    def attitude(self, stamps_ns: Ints) -> Array:
        """Return C_ig, (n, 3, 3), the orientation of the gyro in icrf, at each stamp."""
        t = (stamps_ns - self.start_ns) * 1e-9
        cycle, tau = np.divmod(t, self.begin[-1])
        step = np.clip(np.searchsorted(self.begin, tau, side='right') - 1, 0, len(self.axis) - 1)
        turned = self._turned(step, np.maximum(tau - self.begin[step] - self.dwell, 0.0))
        C_ig = self.C_ig[step] @ rotation.exp(self.axis[step] * turned[:, None])
        return rotation.exp(cycle[:, None] * self.turn) @ C_ig

    def _turned(self, step: Ints, t: Array) -> Array:
        """Return the angle turned, (n,), a time t after a rotation began [rad]."""
        size = np.abs(self.angle[step])
        peak = np.minimum(self.rate, np.sqrt(size * self.acceleration))
        ramp = peak / self.acceleration
        duration = _slew_duration(size, self.rate, self.acceleration)
        t = np.minimum(t, duration)
        up = np.minimum(t, ramp)
        down = np.maximum(t - (duration - ramp), 0.0)
        turned = (0.5 * self.acceleration * (up * up - down * down) + peak * (t - up))
        return np.sign(self.angle[step]) * turned


@remembered
def turns(motion: Motion, stamps_ns: Ints) -> Array:
    """Return the rotation vectors of g between neighbouring stamps, (n - 1, 3) [rad]."""
    C_ig = motion.attitude(stamps_ns)
    return rotation.log(np.swapaxes(C_ig[:-1], -1, -2) @ C_ig[1:])


def _slew_duration(size: Array, rate: float, acceleration: float) -> Array:
    peak = np.minimum(rate, np.sqrt(size * acceleration))
    return np.divide(size, peak, out=np.zeros_like(size), where=peak > 0.0) + peak / acceleration
