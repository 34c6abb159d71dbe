# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The arithmetic of the attitude between frames in numpy: what `track_kernel` has to give."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.measurements import preintegration
from starcal_ros.measurements.samples import GyroSamples


class Attained(NamedTuple):
    """What the gyro says from a frame up to some of its readings.

    Attributes
    ----------
    stamp_ns : (n,) int64 array
        Stamps of the readings.
    C_gi : (n, 3, 3) array
        Attitude.
    rate : (n, 3) array
        Angular velocity without bias, in g [rad/s].
    turn : (n, 3) array
        Sum of the turns since the frame, in g [rad].
    gap_turn : (n,) array
        As in `preintegration.Preintegrated`, since the frame [s^2].
    """

    stamp_ns: Ints
    C_gi: Array
    rate: Array
    turn: Array
    gap_turn: Array

    @property
    def last(self) -> Attained:
        """That at the last reading."""
        return Attained(self.stamp_ns[-1:], self.C_gi[-1:], self.rate[-1:], self.turn[-1:],
                        self.gap_turn[-1:])


def integrate(gyro: GyroSamples, first: int, last: int, start: Attained, bias: Array, gain: Array,
              period_ns: float) -> Attained:
    """Integrate the gyro and return what is attained at the readings ``first:last``.

    Parameters
    ----------
    gyro : GyroSamples
        Readings with increasing stamps, from the last one at or before the start on, or earlier.
    first, last : int
        Which readings, at least one, none of them before the start.
    start : Attained
        Where the integration begins, n = 1.
    bias : (3,) array
        Of the readings [rad/s].
    gain : (3, 3) array
        The rate of g is ``gain @ (reading - bias)``.
    period_ns : float
        Nominal sampling interval.
    """
    samples = gyro[first:last]
    pieces = preintegration.cut(
        gyro, np.array([start.stamp_ns[0], samples.stamp_ns[-1]]), period_ns)
    turns = (pieces.rate - bias) @ gain.T * pieces.dt[:, None]
    # A reading at the start is there without a step.
    rows = np.searchsorted(np.concatenate((start.stamp_ns, pieces.end_ns)), samples.stamp_ns)
    return Attained(
        samples.stamp_ns,
        np.concatenate((start.C_gi,
                        preintegration.track(start.C_gi[0], pieces, bias, gain)))[rows],
        (samples.rate - bias) @ gain.T,
        np.cumsum(np.concatenate((start.turn, turns)), axis=0)[rows],
        np.cumsum(np.concatenate((start.gap_turn, pieces.gap_turn)))[rows])


def spread(root: Array, drift: Array, bent: Array, elapsed: Array, variance: Array) -> Array:
    """Return the covariance of an attitude error, (n, 3, 3), in i [rad^2].

    Parameters
    ----------
    root, drift : (3, k) array
        Root of the covariance at the start, and what it gains in a second.
    bent : (n, 3, k) array
        What it gains besides.
    elapsed : (n,) array
        Time since the start [s].
    variance : (n,) array
        What is added to each axis.
    """
    grown = root + elapsed[:, None, None] * drift + bent
    return grown @ np.swapaxes(grown, -1, -2) + variance[:, None, None] * np.eye(3)
