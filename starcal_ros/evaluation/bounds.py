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

Whitened and stacked these are A x = noise; the information is A' A, sparse, and the bound the
block of its inverse that belongs to the last attitude and the constants. Everything is evaluated
at the truth, and the slopes H are differences of the projection: a wrong Jacobian of the filter
is not repeated here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from starcal_ros import camera
from starcal_ros.estimator import CALIBRATED, LENS, N_STATES, SCALE, Filter
from starcal_ros.measurements import Frames
from starcal_ros.simulation.motion import Motion
from starcal_ros.simulation.truth import Truth
from starcal_ros.places import SIGMA_PX
from starcal_ros.units import NS

Array = NDArray[np.float64]

_STEP_S = 0.02          # of the quadrature of C_ig; a slew turns by 0.01 deg in it


def cramer_rao(filter_: Filter, truth: Truth, frames: Frames, u_i: Array) -> Array:
    """Return the bound on the covariance of T18's 16 states after the last frame.

    Parameters
    ----------
    filter_ : Filter
        Its gyro noise and initial sigmas.
    truth : Truth
        Camera, mounting, motion.
    frames : Frames
        Stamps, sigmas and numbers of the stars; the centroids do not matter.
    u_i : (n_stars, 3) array
        Their apparent places.

    Returns
    -------
    covariance : (16, 16) array
        In the filter's units.
    """
    C_si = truth.attitude_si(frames.stamp_ns)
    frame = np.repeat(np.arange(len(frames)), frames.star_counts)
    r_s = (C_si[frame] @ u_i[..., None])[..., 0]
    weight = (1.0 / np.maximum(frames.sigma, SIGMA_PX[0]))[:, None, None]
    H_s, H_lens = (weight * H for H in _slopes(r_s, truth))
    B = _turned(truth.motion, frames.stamp_ns) if len(frames) > 1 else np.empty((0, 3, 3))
    prior = 1.0 / filter_.initial_sigma[CALIBRATED]
    if filter_.walk == 0.0:
        return _perfect_gyro(H_s @ C_si[frame], H_s, H_lens, frame, B, prior)
    dt = np.diff(frames.stamp_ns) * NS
    return _walking_gyro(H_s @ C_si[frame], H_s, H_lens, frame, B,
                         filter_.walk * np.sqrt(dt), prior)


def _walking_gyro(H_phi: Array, H_s: Array, H_lens: Array, frame: NDArray[np.int64], B: Array,
                  walk: Array, prior: Array) -> Array:
    """Return the bound with an attitude for each frame, tied to the next by the gyro."""
    n = len(walk) + 1
    constants, size = 3 * n, 3 * n + 13
    k, weight = np.arange(n - 1), (1.0 / walk)[:, None, None]
    stars = (_blocks(H_phi, 3 * frame, size)
             + _blocks(H_s, np.full(len(frame), constants + 3), size)
             + _blocks(H_lens, np.full(len(frame), constants + 6), size))
    gyro = (_blocks(weight * np.eye(3), 3 * (k + 1), size)
            - _blocks(weight * np.eye(3), 3 * k, size)
            - _blocks(weight * B, np.full(n - 1, constants), size))
    known = sparse.hstack((sparse.coo_array((13, constants)), sparse.diags_array(prior)))
    # Columns in units of SCALE, so that the factors hold numbers of like size.
    scale = np.concatenate((np.full(constants, SCALE[0]), SCALE[CALIBRATED]))
    A = sparse.vstack((stars, gyro, known)).tocsc() @ sparse.diags_array(scale)
    last = np.r_[constants - 3:size]
    unit = np.zeros((size, N_STATES))
    unit[last, np.arange(N_STATES)] = 1.0
    # In this order, attitudes first, the factor keeps the band of the matrix.
    factor = splu((A.T @ A).tocsc(), permc_spec='NATURAL', diag_pivot_thresh=0.0,
                  options={'SymmetricMode': True})
    covariance = factor.solve(unit)[last]
    return 0.5 * (covariance + covariance.T) * np.outer(SCALE, SCALE)


def _perfect_gyro(H_phi: Array, H_s: Array, H_lens: Array, frame: NDArray[np.int64], B: Array,
                  prior: Array) -> Array:
    """Return the bound where one attitude and the bias give all others.

    The weight of such a gyro has no end: ``phi_k = phi_last - (B_k + B_k+1 + ...) epsilon``.
    """
    ahead = np.concatenate((np.cumsum(B[::-1], axis=0)[::-1], np.zeros((1, 3, 3))))
    stars = np.concatenate((H_phi, -H_phi @ ahead[frame], H_s, H_lens), axis=-1) * SCALE
    stars = stars.reshape(-1, N_STATES)
    information = stars.T @ stars
    information[CALIBRATED, CALIBRATED] += np.diag((prior * SCALE[CALIBRATED])**2)
    return np.linalg.inv(information) * np.outer(SCALE, SCALE)


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
        for step in np.diag(SCALE[LENS])], axis=-1)
    return H_s, H_lens


def _blocks(blocks: Array, column: NDArray[np.int64], width: int) -> sparse.coo_array:
    """Stack (n, r, c) blocks below each other, each at its own column."""
    n, height, breadth = blocks.shape
    row = np.broadcast_to(np.arange(n * height).reshape(n, height, 1), blocks.shape)
    col = np.broadcast_to(column[:, None, None] + np.arange(breadth), blocks.shape)
    return sparse.coo_array((blocks.ravel(), (row.ravel(), col.ravel())), (n * height, width))


def _turned(motion: Motion, stamps_ns: NDArray[np.int64]) -> Array:
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
