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
from functools import cached_property

import numpy as np

from starcal_ros.checks.sky import SeenSky
from starcal_ros.core import robust, rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.units import NS
from starcal_ros.measurements import preintegration
from starcal_ros.measurements.samples import GyroSamples

LEAST = 20
"""Intervals that a comparison needs."""
_LONG = 3.5             # median intervals that an interval may take
_FAR = 0.7              # largest turn from frame to frame [rad]
_SILENT = 20.0          # median gyro intervals that are a silence: what is longer hides a turn
_STEP_S = 0.05          # of the integral of the readings, or their period where that is longer
_H_NS = 10**6           # about a moment, over which its rate is taken


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
    return turns.take((step <= _LONG * robust.middle(step)) & (np.linalg.norm(r, axis=-1) < _FAR))


def covered(turns: Turns, gyro: GyroSamples, margin_s: float) -> Turns:
    """Return the intervals that readings cover without a silence, with a margin on both sides."""
    stamps, margin_ns = gyro.stamp_ns, int(margin_s * 1e9)
    period, ends = robust.middle(np.diff(stamps)), _silences(stamps)
    begin_ns, end_ns = turns.begin_ns - margin_ns, turns.end_ns + margin_ns
    free = (np.searchsorted(stamps[ends + 1], begin_ns, side='right')
            == np.searchsorted(stamps[ends], end_ns, side='left'))
    return turns.take((begin_ns >= stamps[0] - period) & (end_ns <= stamps[-1]) & free)


def _silences(stamp_ns: Ints) -> Ints:
    """Return the readings that a silence follows."""
    step = np.diff(stamp_ns)
    return np.flatnonzero(step > _SILENT * robust.middle(step))


class Gyro:
    """What the gyros say of intervals, whose ends may be moved.

    Parameters
    ----------
    samples : GyroSamples
        With increasing stamps, in rad/s.
    """

    def __init__(self, samples: GyroSamples) -> None:
        self._samples = samples
        self._last: tuple[Ints, preintegration.Preintegrated] | None = None

    def turned(self, turns: Turns, warp: Callable[[Ints], Ints]) -> tuple[Array, Array]:
        """Return g_k (n, 3) and J_k (n, 3, 3) of Eq. (K.2), the stamps moved by a function.

        Parameters
        ----------
        turns : Turns
        warp : callable
            Returns the time on the gyro's clock that a frame's stamp stands for.
        """
        ends, cut = np.unique(np.concatenate((turns.begin_ns, turns.end_ns)), return_inverse=True)
        moved = warp(ends)
        if self._last is None or not np.array_equal(self._last[0], moved):
            self._last = moved, preintegration.preintegrate(
                self._samples, moved, np.zeros(3), self._period_ns)
        pieces = self._last[1]
        at = cut[len(turns):] - 1
        g = rotation.log(pieces.Delta[at])
        return g, np.asarray(np.linalg.solve(rotation.right_jacobian(g), pieces.J[at]),
                             np.float64)

    def slopes(self, turns: Turns, warp: Callable[[Ints], Ints], g: Array) -> tuple[Array, Array]:
        """Return the derivatives of g_k by the times of both frames, (n, 3) each [rad/s].

        What ends later has another piece before it, ``exp(-[w_1 dt x]) Delta``; what begins
        later has one less behind it, ``Delta exp([w_0 dt x])``.

        Parameters
        ----------
        turns, warp
            As of `turned`.
        g : (n, 3) array
            What it has given for them.
        """
        J_r = rotation.right_jacobian(g)
        begin, end = (self._rate(warp(stamp)) for stamp in (turns.begin_ns, turns.end_ns))
        return (np.asarray(np.linalg.solve(J_r, begin[..., None])[..., 0]),
                -np.asarray(np.linalg.solve(np.swapaxes(J_r, -1, -2), end[..., None])[..., 0]))

    def _rate(self, stamp_ns: Ints) -> Array:
        """Return the rate about some moments, (n, 3) [rad/s]."""
        stamps, angle = self._integral
        before, after = (np.stack([np.interp((stamp_ns - stamps[0]) + h, stamps - stamps[0], part)
                                   for part in angle.T], axis=-1) for h in (-_H_NS, _H_NS))
        return np.asarray((after - before) / (2.0 * _H_NS * NS))

    @cached_property
    def _period_ns(self) -> float:
        return robust.middle(np.diff(self._samples.stamp_ns))

    @cached_property
    def _integral(self) -> tuple[Ints, Array]:
        stamps = self._samples.stamp_ns
        dt = np.diff(stamps, prepend=stamps[0]) * NS
        return stamps, np.cumsum(self._samples.rate * dt[:, None], axis=0)


@dataclass(frozen=True)
class Running:
    """The integral of the readings over time, for lags of seconds: good to a thousandth.

    Attributes
    ----------
    begin_s, end_s : (k,) arrays
        Each run of readings without a silence, from the first reading on.
    first : (k,) int64 array
        Where each run begins in the table.
    angle : (m, 3) array
        The integral, a row each step of a run [rad].
    step_s : float
        Of the table.
    """

    begin_s: Array
    end_s: Array
    first: Ints
    angle: Array
    step_s: float

    @classmethod
    def of(cls, samples: GyroSamples) -> Running:
        """Return that of readings with increasing stamps."""
        stamp_s = (samples.stamp_ns - samples.stamp_ns[0]) * NS
        dt = np.diff(stamp_s, prepend=stamp_s[0])
        angle = np.cumsum(-samples.rate * dt[:, None], axis=0)
        ends = [*_silences(samples.stamp_ns).tolist(), len(stamp_s) - 1]
        begins = [0, *(end + 1 for end in ends[:-1])]
        step_s = max(_STEP_S, float(np.median(dt[1:])))
        tables = []
        for begin, end in zip(begins, ends):
            rows = slice(begin, end + 1)
            steps = int((stamp_s[end] - stamp_s[begin]) / step_s) + 2
            at = stamp_s[begin] + step_s * np.arange(steps)
            tables.append(np.stack([np.interp(at, stamp_s[rows], column[rows])
                                    for column in angle.T], axis=-1))
        first = np.cumsum([0, *map(len, tables)])[:-1]
        return cls(stamp_s[begins], stamp_s[ends], first.astype(np.int64),
                   np.concatenate(tables), step_s)

    def turned(self, begin_s: Array, end_s: Array) -> tuple[Array, Mask]:
        """Return about g_k of intervals in seconds from the first reading on.

        Returns
        -------
        g : (m, 3) array
            Of those that one run covers.
        inside : (n,) bool array
            Which these are.
        """
        run = np.searchsorted(self.begin_s, begin_s, side='right') - 1
        inside = (run >= 0) & (end_s <= self.end_s[run])
        run = run[inside]
        return (self._at(run, end_s[inside]) - self._at(run, begin_s[inside]),
                np.asarray(inside))

    def _at(self, run: Ints, at_s: Array) -> Array:
        place = (at_s - self.begin_s[run]) / self.step_s
        row = place.astype(np.int64)
        part = (place - row)[:, None]
        row += self.first[run]
        return np.asarray((1.0 - part) * self.angle[row] + part * self.angle[row + 1])
