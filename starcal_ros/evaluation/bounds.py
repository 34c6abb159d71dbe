# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The Cramér–Rao bound of a scenario: what no unbiased estimator can beat.

Model
-----
All frames at once, in T18's own coordinates, nothing of the filter's recursion. The unknowns are
the attitude errors phi_k of all frames and the 13 constants c = (epsilon, Psi, intrinsics) ::

    gyro      0 = phi_k+1 - phi_k - B_k epsilon - n,     B_k = int C_ig dt,  n ~ N(0, N^2 dt I)
    star      z = H_s C_si phi_k + H_s Psi + H_lens lens - w,               w ~ N(0, sigma^2 I)
    prior     c ~ N(0, initial sigmas)

Whitened and stacked these are A x = noise; the information is A' A, sparse, summed frame by frame,
and the bound the block of its inverse that belongs to the last attitude and the constants.
Everything is evaluated at the truth, and the slopes H are differences of the projection: a wrong
Jacobian of the filter is not repeated here.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from starcal_ros.config.models import observer
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import NS
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import CALIBRATED, EPSILON, N_STATES, PHI, SCALE
from starcal_ros.measurements.samples import Frames
from starcal_ros.measurements.star_directions import SIGMA_PX
from starcal_ros.simulation import sensors
from starcal_ros.simulation.motion import Motion
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places

_BATCH = 500            # frames taken at once
_STEP_S = 0.02          # of the quadrature of C_ig; a slew turns by 0.01 deg in it


def after(scenario: Scenario, times: Sequence[float] | Array) -> Array:
    """Return the bound on the covariance of T18's 16 states at some times, (m, 16, 16).

    Parameters
    ----------
    scenario : Scenario
        Its own duration does not matter.
    times : (m,) sequence
        Since the start, each after a first frame at least [s]. A bound is that of a run of this
        length, after its last frame.

    Returns
    -------
    covariance : (m, 16, 16) array
        In the filter's units.
    """
    tracker = sensors.star_tracker(scenario.replace({'simulation.duration_s': float(max(times))}))
    frames = tracker.next(tracker.count)
    stars = catalog.load(scenario.star_tracker.limiting_magnitude)
    u_i = apparent_places(stars, stars.rows(frames.catalog_id), frames.stamp_ns,
                          frames.star_counts, observer(scenario.observer))
    ends = [int(time * scenario.star_tracker.rate_hz + 1e-6) for time in times]
    return cramer_rao(Filter(scenario), Truth.from_scenario(scenario), frames, u_i, ends)


def cramer_rao(filter_: Filter, truth: Truth, frames: Frames, u_i: Array, ends: Sequence[int]
               ) -> Array:
    """Return the bound on the covariance of T18's 16 states after some of the frames.

    Parameters
    ----------
    filter_ : Filter
        Its gyro noise and initial sigmas.
    truth : Truth
        Camera, mounting, motion.
    frames : Frames
        Stamps, sigmas and catalogue numbers of the stars; the centroids do not matter.
    u_i : (n_stars, 3) array
        Their apparent places.
    ends : sequence of int
        Numbers of frames, from the first on, that are known each time.

    Returns
    -------
    covariance : (m, 16, 16) array
        In the filter's units.
    """
    seen = np.concatenate([np.empty((0, N_STATES, N_STATES)), *(
        _information(truth, frames[low:low + _BATCH],
                     u_i[frames.first[low]:frames.first[min(low + _BATCH, len(frames))]])
        for low in range(0, len(frames), _BATCH))])
    B = (turned(truth.motion, frames.stamp_ns) if len(frames) > 1 else np.empty((0, 3, 3))) * (
        SCALE[EPSILON] / SCALE[PHI])
    prior = np.diag((SCALE / filter_.initial_sigma[:N_STATES])[CALIBRATED]**2)
    walk = filter_.walk * np.sqrt(np.diff(frames.stamp_ns) * NS) / SCALE[0]
    covariance = np.stack([
        _perfect_gyro(seen[:n], B[:n - 1], prior) if filter_.walk == 0.0 else
        _walking_gyro(seen[:n], B[:n - 1], walk[:n - 1], prior) for n in ends])
    return 0.5 * (covariance + np.swapaxes(covariance, -1, -2)) * np.outer(SCALE, SCALE)


def _information(truth: Truth, frames: Frames, u_i: Array) -> Array:
    """Return what the stars of each frame say of its phi and the constants, (n, 16, 16)."""
    C_si = truth.attitude_si(frames.stamp_ns)
    frame = frames.frame_index
    r_s = (C_si[frame] @ u_i[..., None])[..., 0]
    H_s, H_lens = _slopes(r_s, truth)
    A = np.concatenate((H_s @ C_si[frame], np.zeros_like(H_s), H_s, H_lens), axis=-1) * SCALE
    A /= np.maximum(frames.sigma, SIGMA_PX[0])[:, None, None]
    seen = np.zeros((len(frames), N_STATES, N_STATES))
    for k, (low, high) in enumerate(zip(frames.first[:-1], frames.first[1:])):
        rows = A[low:high].reshape(-1, N_STATES)
        seen[k] = rows.T @ rows
    return seen


def _walking_gyro(seen: Array, B: Array, walk: Array, prior: Array) -> Array:
    """Return the bound with an attitude for each frame, tied to the next by the gyro.

    Unknowns are all attitudes, first to last, and then the constants; all arguments are in units
    of SCALE.
    """
    n = len(seen)
    constants, size, k = 3 * n, 3 * n + 13, np.arange(n - 1)
    weight = (1.0 / walk)[:, None, None]
    gyro = (_blocks(weight * np.eye(3), 3 * k, 3 * (k + 1), size)
            - _blocks(weight * np.eye(3), 3 * k, 3 * k, size)
            - _blocks(weight * B, 3 * k, np.full(n - 1, constants), size))
    k = np.arange(n)
    of_phi, mixed = seen[:, PHI, PHI], seen[:, PHI, CALIBRATED]
    last = np.array([constants])
    stars = (_blocks(of_phi, 3 * k, 3 * k, size)
             + _blocks(mixed, 3 * k, np.full(n, constants), size)
             + _blocks(np.swapaxes(mixed, -1, -2), np.full(n, constants), 3 * k, size)
             + _blocks((seen[:, CALIBRATED, CALIBRATED].sum(axis=0) + prior)[None], last, last,
                       size))
    # Attitudes first: in this order the factor keeps the band of the matrix.
    factor = splu((stars + gyro.T @ gyro).tocsc(), permc_spec='NATURAL', diag_pivot_thresh=0.0,
                  options={'SymmetricMode': True})
    asked = np.r_[constants - 3:size]
    unit = np.zeros((size, N_STATES))
    unit[asked, np.arange(N_STATES)] = 1.0
    return factor.solve(unit)[asked]


def _perfect_gyro(seen: Array, B: Array, prior: Array) -> Array:
    """Return the bound where one attitude and the bias give all others.

    The weight of such a gyro has no end: ``phi_k = phi_last - (B_k + B_k+1 + ...) epsilon``.
    """
    T = np.tile(np.eye(N_STATES), (len(seen), 1, 1))
    T[:-1, PHI, EPSILON] = -np.cumsum(B[::-1], axis=0)[::-1]
    information = (np.swapaxes(T, -1, -2) @ seen @ T).sum(axis=0)
    information[CALIBRATED, CALIBRATED] += prior
    return np.linalg.inv(information)


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


def _blocks(blocks: Array, row: Ints, column: Ints, width: int
            ) -> sparse.csc_array:
    """Return a square matrix with (n, r, c) blocks at their rows and columns."""
    rows = row[:, None, None] + np.arange(blocks.shape[1])[:, None]
    columns = column[:, None, None] + np.arange(blocks.shape[2])
    rows, columns = (np.broadcast_to(part, blocks.shape).ravel() for part in (rows, columns))
    return sparse.csc_array((blocks.ravel(), (rows, columns)), (width, width))


def turned(motion: Motion, stamps_ns: Ints) -> Array:
    """Return the integrals of C_ig from each stamp to the next, (n - 1, 3, 3) [s]; Simpson."""
    dt = np.diff(stamps_ns)
    half = max(1, int(np.ceil(dt.max() * NS / _STEP_S / 2.0)))
    part = np.arange(2 * half + 1) / (2 * half)
    weight = np.full(2 * half + 1, 2.0)
    weight[1::2], weight[[0, -1]] = 4.0, 1.0
    total = np.zeros((len(dt), 3, 3))
    for where, w in zip(part, weight / (6.0 * half)):
        total += w * motion.attitude(stamps_ns[:-1] + np.rint(where * dt).astype(np.int64))
    return total * (dt * NS)[:, None, None]
