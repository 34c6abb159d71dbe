# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gyro samples between two stamps, composed once into a rotation and its bias Jacobian.

After Forster et al., IEEE Transactions on Robotics 33(1), 2017, on SO(3) alone. Over the pieces
of constant rate between two frames ::

    Delta = ... exp(-[(omega_2 - b) dt_2 x]) exp(-[(omega_1 - b) dt_1 x])
    C_gi(t1) = Delta C_gi(t0),    Delta(b + eps) = Delta(b) exp([J eps x])             (P.1)
    phi(t1) = phi(t0) + C_ig(t0) J eps

    Delta  (3, 3)  1   rotation of g over the interval
    J      (3, 3)  s   its derivative by the bias

Of a gyro ``omega_m = (I + M) omega + b``, composed for ``omega = G (omega_m - b)``, the eps of J
is taken off omega, and J has nine more columns: the derivative by N of ``omega - N omega``, row
by row. Of one piece that is ``J_r dt (I kron omega')``, where that by eps is ``J_r dt``.

Two neighbouring intervals compose as ``Delta_B Delta_A`` and ``J_A + Delta_A' J_B``, which is
associative: here the pieces are paired up in a tree, all frames at once.

A reading is the mean rate over the interval that ends at its stamp, and the rate is taken as
constant over it, so a frame may fall anywhere. A silence is bridged by the mean of the rates on
its two sides; an angular acceleration alpha that nobody saw may then have turned the body by
alpha t^2 / 2, which is returned as a standard deviation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import NS
from starcal_ros.measurements.samples import GyroSamples

Compose = Callable[[Array, Array, Ints, bool], tuple[Array, Array]]

GAP = 1.5               # sampling intervals without a reading that count as a silence
_BATCH = 1000           # intervals composed at once; bounds the memory to some 20 MB, with M 40 MB


class Preintegrated(NamedTuple):
    """The gyro's account of one or many intervals; leading axes are batch axes.

    Attributes
    ----------
    Delta : (..., 3, 3) array
        ``C_gi(t1) = Delta @ C_gi(t0)`` for the reference bias and gain.
    J : (..., 3, 3) or (..., 3, 12) array
        Derivative by the bias, Eq. (P.1) [s], and by the gyro matrix where asked for.
    duration : (...) array
        Length of the interval [s].
    gap_turn : (...) array
        Turn that a silence may hide, for an angular acceleration of 1 rad/s^2 [s^2].
    reading : (..., 3) array
        The gyro's reading at the end of the interval, bias included [rad/s]; only a time offset
        needs it.
    share : (...) array
        Part of what that reading covers which lies before the end.
    covered : (...) array
        How long a time it covers [s].
    mean : (..., 3) array
        The mean reading over the interval, bias included [rad/s].
    bias : (..., 3) array, optional
        Reference bias [rad/s]; None for the one that is believed.
    gain : (..., 3, 3) array
        Reference G.
    path : (...) array
        Length of the way that g turned [rad]; only the gyro matrix needs it.
    """

    Delta: Array
    J: Array
    duration: Array
    gap_turn: Array
    reading: Array = np.zeros(3)
    share: Array = np.ones(())
    covered: Array = np.ones(())
    mean: Array = np.zeros(3)
    bias: Array | None = None
    gain: Array = np.eye(3)
    path: Array = np.zeros(())

    def take(self, k: int) -> Preintegrated:
        """Return one of many intervals."""
        return Preintegrated._make(
            part if part is None else part[k] for part in self)

    @classmethod
    def stacked(cls, parts: Sequence[Preintegrated], axis: int = 0) -> Preintegrated:
        """Return intervals of the same kind as those of a batch."""
        return cls(*(np.stack(part, axis=axis) for part in zip(*parts)))


class Pieces(NamedTuple):
    """A stretch of time in pieces of constant rate.

    Attributes
    ----------
    end_ns : (n,) int64 array
        End of each piece.
    dt : (n,) array
        Its length [s].
    rate : (n, 3) array
        Rate of g, resolved in g, bias included [rad/s].
    gap_turn : (n,) array
        As in `Preintegrated`; zero where a reading covers the piece.
    """

    end_ns: Ints
    dt: Array
    rate: Array
    gap_turn: Array


def cut(gyro: GyroSamples, cuts_ns: Ints, period_ns: float) -> Pieces:
    """Cut the time from the first of `cuts_ns` to the last into pieces of constant rate.

    Parameters
    ----------
    gyro : GyroSamples
        Readings with increasing stamps, the last one not before the last cut.
    cuts_ns : (n,) int64 array
        Stamps, increasing, at which a piece must end.
    period_ns : float
        Nominal sampling interval: what a reading after a silence covers.
    """
    first = max(int(np.searchsorted(gyro.stamp_ns, cuts_ns[0], side='right')) - 1, 0)
    gyro = gyro[first:int(np.searchsorted(gyro.stamp_ns, cuts_ns[-1])) + 1]
    stamps = gyro.stamp_ns
    begins = stamps - _covered_ns(stamps, period_ns)
    # Sorted by hand: numpy's unique hashes, which costs ten times as much.
    ends = np.sort(np.concatenate((stamps, begins, cuts_ns)), kind='stable')
    fresh = np.concatenate(([True], ends[1:] > ends[:-1]))
    ends = ends[fresh & (ends >= cuts_ns[0]) & (ends <= cuts_ns[-1])]
    start, end = ends[:-1], ends[1:]
    sample = np.searchsorted(stamps, end)           # the first reading that ends here or later
    silent = end <= begins[sample]
    rate, gap_turn = np.take(gyro.rate, sample, axis=0), np.zeros(len(end))
    if silent.any():
        after = sample[silent]
        before = np.maximum(after - 1, 0)
        rate[silent] = 0.5 * (gyro.rate[before] + gyro.rate[after])
        # Before the very first reading a silence has an end alone, from which it is counted back.
        known = np.where(after > 0, stamps[before], begins[after])
        gap_turn[silent] = 0.5 * np.abs(((end[silent] - known) * NS)**2
                                        - ((start[silent] - known) * NS)**2)
    return Pieces(end, (end - start) * NS, rate, gap_turn)


def preintegrate(gyro: GyroSamples, cuts_ns: Ints, bias: Array, period_ns: float,
                 with_matrix: bool = False, gain: Array = np.eye(3),
                 compose: Compose | None = None) -> Preintegrated:
    """Compose the readings between neighbouring stamps.

    Parameters
    ----------
    gyro : GyroSamples
        Readings with increasing stamps, the last one not before the last cut.
    cuts_ns : (n + 1,) int64 array
        Stamps, increasing.
    bias : (3,) array
        Reference bias [rad/s].
    period_ns : float
        Nominal sampling interval [ns].
    with_matrix : bool
        Give the derivative by the gyro matrix too.
    gain : (3, 3) array
        Reference G: the rate of g is ``gain @ (reading - bias)``.
    compose : callable, optional
        What composes the pieces in place of `composed`.

    Returns
    -------
    Preintegrated
        With n intervals.
    """
    pieces = cut(gyro, cuts_ns, period_ns)
    n = len(cuts_ns) - 1
    last = np.searchsorted(gyro.stamp_ns, cuts_ns[1:])
    covered_ns = _covered_ns(gyro.stamp_ns, period_ns)[last]
    share = 1.0 - (gyro.stamp_ns[last] - cuts_ns[1:]) / covered_ns
    first = np.searchsorted(pieces.end_ns, cuts_ns, side='right')
    interval = np.repeat(np.arange(n), np.diff(first))
    theta = (pieces.rate - bias) @ gain.T * pieces.dt[:, None]
    Delta, J = (compose or composed)(theta, pieces.dt, first, with_matrix)
    return Preintegrated(Delta, J, np.diff(cuts_ns) * NS,
                         np.bincount(interval, pieces.gap_turn, n).astype(np.float64),
                         gyro.rate[last], np.maximum(share, 0.0),
                         np.asarray(covered_ns * NS, np.float64),
                         _means(pieces, interval, np.diff(cuts_ns) * NS),
                         np.broadcast_to(bias, (n, 3)), np.broadcast_to(gain, (n, 3, 3)),
                         np.bincount(interval, np.sqrt(np.einsum('ki,ki->k', theta, theta)),
                                     n).astype(np.float64))


def _means(pieces: Pieces, interval: Ints, duration: Array) -> Array:
    """Return the mean rate over each interval, (n, 3); pieces are of the `interval`-th."""
    turns = [np.bincount(interval, axis * pieces.dt, len(duration)) for axis in pieces.rate.T]
    return np.stack(turns, axis=-1) / np.maximum(duration, NS)[:, None]


def _covered_ns(stamps: Ints, period_ns: float) -> Ints:
    """Return how long a time each reading covers, (n,)."""
    # A live node comes here with each reading: numpy's diff would take half of the time.
    step = np.concatenate(([int(period_ns)], stamps[1:] - stamps[:-1]))
    return np.where(step > GAP * period_ns, int(period_ns), step)


def composed(theta: Array, dt: Array, first: Ints, with_matrix: bool) -> tuple[Array, Array]:
    """Compose pieces of constant rate into those of each interval, Eq. (P.1).

    Parameters
    ----------
    theta : (k, 3) array
        Turn of g in each piece [rad].
    dt : (k,) array
        Its length [s].
    first : (n + 1,) int64 array
        Where the pieces of each interval begin, and the last end.
    with_matrix : bool
        Give the derivative by the gyro matrix too.

    Returns
    -------
    Delta : (n, 3, 3) array
    J : (n, 3, 3) or (n, 3, 12) array
    """
    n = len(first) - 1
    Delta, J = np.empty((n, 3, 3)), np.empty((n, 3, 12 if with_matrix else 3))
    for low in range(0, n, _BATCH):
        high = min(low + _BATCH, n)
        rows = slice(first[low], first[high])
        interval = np.repeat(np.arange(high - low), np.diff(first[low:high + 1]))
        rank = np.arange(first[low], first[high]) - first[low:high][interval]
        Delta[low:high], J[low:high] = _paired_up(
            theta[rows], dt[rows], interval, rank, high - low, with_matrix)
    return Delta, J


def _paired_up(theta: Array, dt: Array, interval: Ints, rank: Ints,
               n: int, with_matrix: bool) -> tuple[Array, Array]:
    """Compose pieces, each the `rank`-th of its interval, into n Delta and J."""
    width = 1 << int(rank.max(initial=0)).bit_length()
    Delta = np.broadcast_to(np.eye(3), (n, width, 3, 3)).copy()
    J: Array = np.zeros((n, width, 3, 12 if with_matrix else 3))
    J_r = rotation.right_jacobian(-theta)
    Delta[interval, rank] = rotation.exp(-theta)
    J[interval, rank, :, :3] = dt[:, None, None] * J_r
    if with_matrix:
        J[interval, rank, :, 3:] = (J_r[..., None] * theta[:, None, None]).reshape(-1, 3, 9)
    while width > 1:
        first, second = Delta[:, ::2], Delta[:, 1::2]
        J = J[:, ::2] + np.swapaxes(first, -1, -2) @ J[:, 1::2]
        Delta = second @ first
        width //= 2
    return Delta[:, 0], J[:, 0]


def track(C_gi: Array, pieces: Pieces, bias: Array, gain: Array = np.eye(3)) -> Array:
    """Return C_gi, (n, 3, 3), at the end of each piece, from C_gi (3, 3) at the beginning.

    The rate of g is ``gain @ (reading - bias)``.
    """
    attitude = np.empty((len(pieces.dt), 3, 3))
    steps = rotation.exp(-(pieces.rate - bias) @ gain.T * pieces.dt[:, None])
    for k, step in enumerate(steps):
        C_gi = attitude[k] = step @ C_gi
    return attitude
