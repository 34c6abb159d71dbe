# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How the camera turned from frame to frame, by the stars and by the gyros.

Model
-----
With ``Delta`` what the readings make of the interval between two frames (`preintegration`)::

    r_k = log(C_k C_k-1')       by the stars, in s
    g_k = log(Delta_k)          by the gyros, in g, their readings taken as they are
    r_k = A g_k + A J_k b + delta_k - C_k C_k-1' delta_k-1 + n_k                          (K.2)

    A        C_sg where all is right; ``log(C Delta C') = C log(Delta)`` is exact
    J_k b    what a bias b takes off the readings [rad]
    delta_k  error of the attitude of frame k, of covariance R_k of Eq. (K.1)
    n_k      N^2 dt of each axis: the angular random walk

Neighbouring intervals share a frame, so the covariance of all of them is block tridiagonal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from starcal_ros.checks.sky import SeenSky
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.units import NS
from starcal_ros.measurements import preintegration
from starcal_ros.measurements.samples import GyroSamples

LEAST = 20
"""Intervals that a comparison needs."""
_LONG = 3.5             # median intervals that an interval may take
_FAR = 0.7              # largest turn from frame to frame [rad]
_SILENT = 20.0          # median gyro intervals that are a silence: what is longer hides a turn


@dataclass(frozen=True)
class Turns:
    """The intervals of a recording for which both are known.

    Attributes
    ----------
    begin_ns, end_ns : (n,) int64 array
        Stamps of the two frames.
    r : (n, 3) array
        Turn by the stars [rad].
    C : (n, 3, 3) array
        C_k C_k-1'.
    R_begin, R_end : (n, 3, 3) array
        Covariances of the two attitudes.
    chained : (n,) bool array
        Whether an interval begins where the one before it ends.
    """

    begin_ns: Ints
    end_ns: Ints
    r: Array
    C: Array
    R_begin: Array
    R_end: Array
    chained: Mask

    def __len__(self) -> int:
        return len(self.r)

    @property
    def dt(self) -> Array:
        """Length of the intervals, (n,) [s]."""
        return np.asarray((self.end_ns - self.begin_ns) * NS)

    @property
    def since(self) -> Array:
        """Ends of the intervals from the middle of the recording, (n,) [s]."""
        return (self.end_ns - (self.begin_ns[0] + self.end_ns[-1]) // 2) * NS

    def take(self, rows: Mask | Ints) -> Turns:
        """Return some of the intervals, given by a mask or by their numbers."""
        begin_ns, end_ns = self.begin_ns[rows], self.end_ns[rows]
        return Turns(begin_ns, end_ns, self.r[rows], self.C[rows], self.R_begin[rows],
                     self.R_end[rows], np.concatenate(([False], begin_ns[1:] == end_ns[:-1])))


def of_stars(sky: SeenSky) -> Turns:
    """Return the turns by the stars, without those that are too long to compare."""
    C = sky.C_si[1:] @ np.swapaxes(sky.C_si[:-1], -1, -2)
    r, step = rotation.log(C), np.diff(sky.stamp_ns)
    every: Mask = np.ones(len(r), bool)
    turns = Turns(sky.stamp_ns[:-1], sky.stamp_ns[1:], r, C, sky.R[:-1], sky.R[1:], every)
    return turns.take((step <= _LONG * np.median(step)) & (np.linalg.norm(r, axis=-1) < _FAR))


def covered(turns: Turns, gyro: GyroSamples, margin_s: float) -> Turns:
    """Return the intervals that readings cover without a silence, with a margin on both sides."""
    stamps, margin_ns = gyro.stamp_ns, int(margin_s * 1e9)
    period = float(np.median(np.diff(stamps)))
    ends = np.flatnonzero(np.diff(stamps) > _SILENT * period)
    begin_ns, end_ns = turns.begin_ns - margin_ns, turns.end_ns + margin_ns
    free = (np.searchsorted(stamps[ends + 1], begin_ns, side='right')
            == np.searchsorted(stamps[ends], end_ns, side='left'))
    return turns.take((begin_ns >= stamps[0] - period) & (end_ns <= stamps[-1]) & free)


@dataclass(frozen=True)
class Gyro:
    """What the gyros say of intervals, whose ends may be moved.

    Attributes
    ----------
    samples : GyroSamples
        With increasing stamps, in rad/s.
    """

    samples: GyroSamples

    def turned(self, turns: Turns, warp: Callable[[Ints], Ints]) -> tuple[Array, Array]:
        """Return g_k (n, 3) and J_k (n, 3, 3) of Eq. (K.2), the stamps moved by a function.

        Parameters
        ----------
        turns : Turns
        warp : callable
            Returns the time on the gyro's clock that a frame's stamp stands for.
        """
        ends, cut = np.unique(np.concatenate((turns.begin_ns, turns.end_ns)), return_inverse=True)
        period_ns = float(np.median(np.diff(self.samples.stamp_ns)))
        pieces = preintegration.preintegrate(self.samples, warp(ends), np.zeros(3), period_ns)
        at = cut[len(turns):] - 1
        g = rotation.log(pieces.Delta[at])
        return g, np.asarray(np.linalg.solve(rotation.right_jacobian(g), pieces.J[at]),
                             np.float64)


@dataclass(frozen=True)
class Running:
    """The integral of the readings over time, for lags of seconds: good to a thousandth."""

    stamp_s: Array
    angle: Array

    @classmethod
    def of(cls, samples: GyroSamples) -> Running:
        """Return that of readings with increasing stamps."""
        stamp_s = (samples.stamp_ns - samples.stamp_ns[0]) * NS
        dt = np.diff(stamp_s, prepend=stamp_s[0])
        return cls(stamp_s, np.cumsum(-samples.rate * dt[:, None], axis=0))

    def turned(self, begin_s: Array, end_s: Array) -> Array:
        """Return about g_k, (n, 3), of intervals in seconds from the first reading on."""
        return np.stack([np.interp(end_s, self.stamp_s, column)
                         - np.interp(begin_s, self.stamp_s, column)
                         for column in self.angle.T], axis=-1)
