# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The true values behind a simulated recording: camera, mounting, bias, attitude.

``truth/parameters`` and ``truth.json`` hold constants: where the bias walks, its value at the
start; where the mounting drifts, its mean. `Truth` has both as functions of time too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from starcal_ros.config.models import detector, intrinsics, mounting_matrix, true_time_offset_s
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.camera import INTRINSICS_KEYS, Detector
from starcal_ros.core.units import DEG_PER_HOUR
from starcal_ros.simulation.errors import gyro_scale, switched_on
from starcal_ros.simulation.motion import Motion

VECTOR_LABEL = ('gyro_bias_rad_s[3] fixed_angles_rad[3] u0_px v0_px f_mm k1_mm-2 k2_mm-4 p1_mm-1 '
                'p2_mm-1')
VECTOR_SIZE = 13

OverTime = Callable[[Ints], Array]


@dataclass(frozen=True)
class Truth:
    """What the simulated sensors see.

    Attributes
    ----------
    motion : Motion
        Attitude as a function of time.
    detector : Detector
        Pixels of the camera.
    intrinsics : (7,) array
        Camera, as in `starcal_ros.core.camera`.
    C_sg : (3, 3) array
        Mounting, its mean where it drifts.
    bias : (3,) array
        Gyro bias, in g, at the start [rad/s].
    drifts : sequence of callables
        Rotation vectors (n, 3), in s, that turn the mounting from its mean at stamps (n,), one
        after the other [rad].
    walks : sequence of callables
        Changes (n, 3) of the bias since the start, in g, at stamps (n,) [rad/s].
    gyro_matrix : (3, 3) array
        M of `gyro_scale`.
    time_offset : float
        Stamp of a frame minus the middle of its exposure [s].
    unknown_offset : float
        The part of it that the nominal time offset leaves [s].
    """

    motion: Motion
    detector: Detector
    intrinsics: Array
    C_sg: Array
    bias: Array
    drifts: Sequence[OverTime] = ()
    walks: Sequence[OverTime] = ()
    gyro_matrix: Array = field(default_factory=lambda: np.zeros((3, 3)))
    time_offset: float = 0.0
    unknown_offset: float = 0.0

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> Truth:
        """Take each value from the group ``truth``, or the nominal one where it is left out."""
        truth = scenario.truth
        given = truth.mounting.fixed_angles_deg or truth.mounting.quaternion_xyzw
        bias = truth.gyro.bias_deg_h or scenario.gyro.bias_deg_h
        return cls(Motion.from_scenario(scenario), detector(scenario.camera),
                   intrinsics(scenario.camera, truth.camera),
                   mounting_matrix(truth.mounting if given else scenario.mounting),
                   np.array(bias) * DEG_PER_HOUR, switched_on('mounting', scenario),
                   switched_on('bias', scenario), gyro_scale.matrix(scenario),
                   true_time_offset_s(scenario),
                   true_time_offset_s(scenario) - scenario.star_tracker.time_offset_s)

    @property
    def moves(self) -> bool:
        """Whether the bias or the mounting changes with time."""
        return bool(self.drifts or self.walks)

    def bias_at(self, stamps_ns: Ints) -> Array:
        """Return the gyro bias, (n, 3), in g at each stamp [rad/s]."""
        bias = np.broadcast_to(self.bias, (len(stamps_ns), 3))
        for walk in self.walks:
            bias = bias + walk(stamps_ns)
        return bias

    def mounting_at(self, stamps_ns: Ints) -> Array:
        """Return C_sg, (n, 3, 3), at each stamp."""
        C_sg = np.broadcast_to(self.C_sg, (len(stamps_ns), 3, 3))
        for drift in self.drifts:
            C_sg = rotation.exp(drift(stamps_ns)) @ C_sg
        return C_sg

    def attitude_si(self, stamps_ns: Ints) -> Array:
        """Return C_si, (n, 3, 3), of the star tracker at each stamp."""
        return self.mounting_at(stamps_ns) @ np.swapaxes(self.motion.attitude(stamps_ns), -1, -2)

    def vector(self) -> Array:
        """Return the values of ``truth/parameters``, (13,), as VECTOR_LABEL names them."""
        return np.concatenate((self.bias, rotation.to_fixed_angles(self.C_sg), self.intrinsics))

    def as_dict(self) -> dict[str, Any]:
        """Return the constant values under the names of RESULT.json."""
        return from_vector(self.vector())


def from_vector(vector: Array) -> dict[str, Any]:
    """Return the values of ``truth/parameters``, (13,), under the names of RESULT.json."""
    bias, angles, intrinsics_ = np.split(vector, [3, 6])
    return {
        'intrinsics': dict(zip(INTRINSICS_KEYS, intrinsics_.tolist())),
        'gyro_bias_deg_h': (bias / DEG_PER_HOUR).tolist(),
        'mounting': {
            'quaternion_xyzw': rotation.to_quaternion(
                rotation.from_fixed_angles(angles)).tolist(),
            'fixed_angles_deg': np.degrees(angles).tolist(),
        },
    }
