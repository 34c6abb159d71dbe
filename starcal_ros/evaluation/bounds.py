# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The Cramér–Rao bound of a scenario: what no unbiased estimator can beat.

Model
-----
T18's own coordinates, nothing of the filter's recursion. The unknowns of frame k are the attitude
error phi and the calibrated states c = (epsilon, Psi, intrinsics), behind them the optional ones::

    gyro      phi_k+1 = phi_k + int K (epsilon(t) dt + N dw),    K = C_ig (I + M)^-1
    states    c_k+1 = c_k + int Q dv        w, v Wiener processes; Q = 0 for a state that stays
    star      z = H_s C_si phi_k + H_s Psi + H_lens lens - n,               n ~ N(0, sigma^2 I)
    prior     c_0 ~ N(0, initial sigmas)

An interval adds noise to phi and epsilon together, with ``F(t) = int K dt`` from t to its end and
its mean F_m over the interval of length T ::

    epsilon   Q sqrt(T) n1
    phi       F_m Q sqrt(T) n1 + n2
    cov n2 =  N^2 int K K' dt + int (F - F_m) Q Q' (F - F_m)' dt

This is least squares: whitened rows A x = noise for all unknowns. Householder's reflections
eliminate one frame after the other, so that what is kept is a triangle R, and R' R is the
information on the unknowns of the last frame (Bierman, *Factorization Methods for Discrete
Sequential Estimation*, 1977, Ch. VI). States that stay and a gyro without noise have no rows of
their own; nothing is inverted but R at the end. On the right of the rows stands, for each initial
sigma, what a first error of that size adds: what is left of it at the end, Z, is the prior's part.

Everything is evaluated at the truth, and the slopes H are differences of the projection: a wrong
Jacobian of the filter is not repeated here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from starcal_ros.config.models import observer
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import NS
from starcal_ros.evaluation import augmented
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import CALIBRATED, EPSILON, N_STATES, PHI
from starcal_ros.measurements.samples import Frames
from starcal_ros.measurements.star_directions import LEAST_SIGMA_PX
from starcal_ros.simulation import sensors
from starcal_ros.simulation.motion import Motion
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places

_BATCH = 500            # frames taken at once
_STEP_S = 0.02          # of the quadrature of C_ig; a slew turns by 0.01 deg in it


@dataclass(frozen=True)
class Bound:
    """The bound after a frame.

    Attributes
    ----------
    root : (n, n) array
        Root of the covariance of the n = 16 + m states, in the filter's units.
    prior : (n, n - 3) array
        Z: first errors of the calibrated and the optional states, in their initial sigmas, leave
        ``root @ prior`` of themselves as the mean error.
    """

    root: Array
    prior: Array

    @property
    def covariance(self) -> Array:
        """Bound on the covariance, (n, n), in the filter's units."""
        return self.root @ self.root.T

    @property
    def sigma(self) -> Array:
        """Bound on the standard deviations, (n,), in the filter's units."""
        return np.linalg.norm(self.root, axis=-1)

    @property
    def prior_part(self) -> Array:
        """Part of each state's variance that is the prior's, (n,): 1 where nothing is seen."""
        return np.sum((self.root @ self.prior)**2, axis=-1) / self.sigma**2

    def nees_moments(self, first: Array) -> tuple[float, float]:
        """Return mean and variance of the NEES of runs that all begin with the same errors.

        Parameters
        ----------
        first : (n - 3,) array
            First errors of the calibrated and the optional states, in their initial sigmas. If
            they were drawn for each run the mean would be n, the variance 2 n.
        """
        left = self.prior @ first
        drawn = np.eye(len(left)) - self.prior @ self.prior.T
        return (float(np.trace(drawn) + left @ left),
                float(2.0 * np.sum(drawn**2) + 4.0 * left @ drawn @ left))


def after(scenario: Scenario, times: Sequence[float] | Array) -> Array:
    """Return the bound on the covariance of the 16 + m states at some times.

    Parameters
    ----------
    scenario : Scenario
        Its own duration does not matter.
    times : (n,) sequence
        Since the start, each after a first frame at least [s]. A bound is that of a run of this
        length, after its last frame.

    Returns
    -------
    covariance : (n, 16 + m, 16 + m) array
        In the filter's units.
    """
    return np.stack([bound.covariance for bound in at(scenario, times)])


def at(scenario: Scenario, times: Sequence[float] | Array) -> list[Bound]:
    """Return the bounds at some times, as `after` takes them."""
    tracker = sensors.star_tracker(scenario.replace({'simulation.duration_s': float(max(times))}))
    frames = tracker.next(tracker.count)
    stars = catalog.load(scenario.star_tracker.limiting_magnitude)
    u_i = apparent_places(stars, stars.rows(frames.catalog_id), frames.stamp_ns,
                          frames.star_counts, observer(scenario.observer))
    ends = [int(time * scenario.star_tracker.rate_hz + 1e-6) for time in times]
    return cramer_rao(Filter(scenario), Truth.from_scenario(scenario), frames, u_i, ends)


def cramer_rao(filter_: Filter, truth: Truth, frames: Frames, u_i: Array, ends: Sequence[int]
               ) -> list[Bound]:
    """Return the bounds after some of the frames.

    Parameters
    ----------
    filter_ : Filter
        Its gyro noise, process noise, initial sigmas, and which optional states it has.
    truth : Truth
        Camera, mounting, motion, gyro.
    frames : Frames
        Stamps, sigmas and catalogue numbers of the stars; the centroids do not matter.
    u_i : (n_stars, 3) array
        Their apparent places.
    ends : sequence of int
        Numbers of frames, from the first on, that are known each time.
    """
    states = len(filter_.scale)
    R = np.diag(filter_.scale / filter_.initial_sigma)
    R[PHI] = 0.0
    R = np.concatenate((R, np.eye(states)[:, PHI.stop:]), axis=1)
    known: dict[int, Bound] = {}
    for low in range(0, len(frames), _BATCH):
        part = frames[low:low + _BATCH]
        seen = _seen(filter_, truth, part,
                     u_i[frames.first[low]:frames.first[low + len(part)]])
        stamps = frames.stamp_ns[max(low - 1, 0):low + len(part)]
        turn, noise = _interval(filter_, truth, stamps)
        for k in range(len(part)):
            number = low + k + 1
            if number > 1:
                step = k - len(part)
                R = _carried(R, turn[step], noise[step])
            R = _triangle(np.concatenate((R, seen[k])))[:states]
            if number in ends:
                known[number] = Bound(filter_.scale[:, None] * np.linalg.inv(R[:, :states]),
                                      R[:, states:])
    return [known[number] for number in ends]


def _triangle(rows: Array) -> Array:
    """Return the triangle that a reflection of rows leaves."""
    return np.asarray(np.linalg.qr(rows, mode='r'))


def _carried(R: Array, turn: Array, noise: Array) -> Array:
    """Return R for the unknowns of the next frame.

    Parameters
    ----------
    R : (n, n + c) array
        For those of this frame, and Z on its right.
    turn : (3, n) array
        What each state adds to phi; nothing for phi itself.
    noise : (n, p) array
        Root of the covariance that the interval adds.
    """
    n, p = noise.shape
    rows = np.zeros((p + n, p + R.shape[1]))
    rows[range(p), range(p)] = 1.0
    rows[p:, p:] = R
    rows[p:, p:p + n] -= R[:, PHI] @ turn       # in the unknowns of the next frame, turned back
    rows[p:, :p] = -rows[p:, p:p + n] @ noise
    return _triangle(rows)[p:, p:]


def _seen(filter_: Filter, truth: Truth, frames: Frames, u_i: Array) -> Array:
    """Return a root of what the stars of each frame say, (n, q, n + c) rows of `_carried`'s R."""
    middle_ns = frames.stamp_ns - round(truth.time_offset / NS)
    C_si = truth.attitude_si(middle_ns)
    frame = frames.frame_index
    r_s = (C_si[frame] @ u_i[..., None])[..., 0]
    H_s, H_lens = _slopes(r_s, truth)
    A = np.zeros((len(u_i), 2, len(filter_.scale)))
    A[..., :N_STATES] = np.concatenate(
        (H_s @ C_si[frame], np.zeros_like(H_s), H_s, H_lens), axis=-1)
    for state, _, among in filter_.augmentation.errors():
        imaged = augmented.of(state).imaged
        if imaged is not None:
            A[..., among] = imaged(truth, middle_ns[frame], u_i)
    A *= filter_.scale / np.maximum(frames.sigma, LEAST_SIGMA_PX)[:, None, None]
    rows = np.zeros((len(frames), int(frames.star_counts.max(initial=0)), *A.shape[1:]))
    rows[frame, np.arange(len(frame)) - frames.first[frame]] = A
    root = _triangle(rows.reshape(len(frames), -1, A.shape[-1]))
    return np.concatenate((root, np.zeros((*root.shape[:2], root.shape[2] - PHI.stop))), axis=-1)


def _interval(filter_: Filter, truth: Truth, stamps_ns: Ints) -> tuple[Array, Array]:
    """Return `turn` and `noise` of `_carried` for each interval between stamps."""
    scale, states = filter_.scale, len(filter_.scale)
    n = len(stamps_ns) - 1
    turn = np.zeros((n, 3, states))
    noise = np.zeros((n, states, 0))
    if n == 0:
        return turn, noise
    nodes, h = _nodes(stamps_ns)
    K = _at(nodes, truth.motion.attitude) @ augmented.gain(truth)
    pieces = _simpson(K, h)
    turn[..., EPSILON] = pieces.sum(axis=0)
    for state, _, among in filter_.augmentation.errors():
        turning = augmented.of(state).turning
        if turning is not None:
            turn[..., among] = _simpson(_at(nodes, partial(turning, truth)), h).sum(axis=0)

    T = np.diff(stamps_ns) * NS
    q_bias = filter_.density[:3]
    own = filter_.walk**2 * h[:, None, None] * (
        K[1::2] @ np.swapaxes(K[1::2], -1, -2)).sum(axis=0)
    columns = []
    if q_bias.any():
        # F in the middle of each piece; on the way through it F changes by the piece.
        F = np.cumsum(pieces[::-1], axis=0)[::-1] - 0.5 * pieces
        mean = F.mean(axis=0)
        for part in (F - mean, pieces / np.sqrt(12.0)):
            spread = part * q_bias
            own += h[:, None, None] * (spread @ np.swapaxes(spread, -1, -2)).sum(axis=0)
        bias = np.zeros((n, states, 3))
        steps = np.sqrt(T)[:, None, None] * np.diag(q_bias)
        bias[:, PHI], bias[:, EPSILON] = mean @ steps, steps
        columns.append(bias)
    if own.any():
        columns.append(np.zeros((n, states, 3)))
        columns[-1][:, PHI] = np.linalg.cholesky(own)
    others = EPSILON.stop + np.flatnonzero(filter_.density[3:])
    columns.append(np.zeros((n, states, len(others))))
    columns[-1][:, others, range(len(others))] = (
        np.sqrt(T)[:, None] * filter_.density[others - CALIBRATED.start])
    return turn * scale / scale[PHI, None], np.concatenate(columns, axis=-1) / scale[:, None]


def _slopes(r_s: Array, truth: Truth) -> tuple[Array, Array]:
    """Return d uv / d Psi (n, 2, 3) and d uv / d intrinsics (n, 2, 7), by central differences."""
    def project(r: Array, intrinsics: Array) -> Array:
        return camera.project(r, intrinsics, truth.detector.pitch_mm)

    lens, angle = truth.intrinsics, 1e-6
    H_s = np.stack([
        (project(r_s + angle * np.cross(axis, r_s), lens)
         - project(r_s - angle * np.cross(axis, r_s), lens)) / (2.0 * angle)
        for axis in np.eye(3)], axis=-1)
    H_lens = np.stack([
        (project(r_s, lens + step) - project(r_s, lens - step)) / (2.0 * step.sum())
        for step in np.diag(camera.INTRINSICS_SCALE)], axis=-1)
    return H_s, H_lens


def turned(motion: Motion, stamps_ns: Ints) -> Array:
    """Return the integrals of C_ig from each stamp to the next, (n - 1, 3, 3) [s]."""
    nodes, h = _nodes(stamps_ns)
    return _simpson(_at(nodes, motion.attitude), h).sum(axis=0)


def _nodes(stamps_ns: Ints) -> tuple[Ints, Array]:
    """Return stamps (2 J + 1, n - 1) in each interval, and the length of its J pieces [s]."""
    dt = np.diff(stamps_ns)
    pieces = max(1, int(np.ceil(dt.max() * NS / _STEP_S / 2.0)))
    part = np.arange(2 * pieces + 1)[:, None] / (2 * pieces)
    return stamps_ns[:-1] + np.rint(part * dt).astype(np.int64), dt * NS / pieces


def _at(nodes_ns: Ints, of: Callable[[Ints], Array]) -> Array:
    """Return a function's values (2 J + 1, n - 1, 3, k) at the nodes."""
    values = of(nodes_ns.ravel())
    return values.reshape(*nodes_ns.shape, *values.shape[1:])


def _simpson(values: Array, h: Array) -> Array:
    """Return the integral over each of the J pieces, (J, n - 1, 3, k), by Simpson's rule."""
    return (values[:-1:2] + 4.0 * values[1::2] + values[2::2]) * (h / 6.0)[:, None, None]
