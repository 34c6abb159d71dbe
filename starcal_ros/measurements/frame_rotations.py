# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How the star tracker turned from frame to frame, as the gyros saw it."""

from __future__ import annotations

import numpy as np

from starcal_ros.config.models import mounting_matrix
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.units import DEG_PER_HOUR
from starcal_ros.measurements import preintegration
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.measurements.timeline import Stamped


def from_gyro(gyro: GyroSamples, frames: Stamped, scenario: Scenario) -> list[Array | None]:
    """Return how the star tracker turned up to each frame from the one before, C_s1s0.

    None for the first one, and where the readings do not reach from frame to frame.

    Parameters
    ----------
    gyro : GyroSamples
        With increasing stamps.
    frames : Stamped
        With increasing stamps.
    scenario : Scenario
        Mounting, nominal bias and rate of the gyros.
    """
    turned: list[Array | None] = [None] * len(frames)
    if not len(gyro):
        return turned
    C_sg, period_ns = mounting_matrix(scenario.mounting), 1e9 / scenario.gyro.rate_hz
    begin_ns = gyro.stamp_ns[0] - int(period_ns)        # a reading's stamp is its end
    covered = np.flatnonzero((frames.stamp_ns >= begin_ns)
                             & (frames.stamp_ns <= gyro.stamp_ns[-1]))
    if len(covered) < 2:
        return turned
    pieces = preintegration.preintegrate(
        gyro, frames.stamp_ns[covered], np.array(scenario.gyro.bias_deg_h) * DEG_PER_HOUR,
        period_ns)
    for k, Delta in zip(covered[1:].tolist(), pieces.Delta):
        turned[k] = C_sg @ Delta @ C_sg.T
    return turned
