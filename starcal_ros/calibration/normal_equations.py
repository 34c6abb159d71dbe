# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Normal equations of a bundle adjustment, the attitudes eliminated, Eq. (B.2) and (B.3).

Attitudes are blocks of a frame each and go first, in dense algebra; the unknown directions are
what is left beside the camera, in a sparse matrix.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask

FOCAL = 2
"""Where the focal length stands among the values of every lens model."""
_SINGULAR, _ROUNDING = 1e-10, 1e-16     # least eigenvalue over the largest


class BundleStep(NamedTuple):
    """The error of a state.

    Attributes
    ----------
    camera : (p,) array
        Of the intrinsics, zero where one is held.
    attitude : (n, 3) or (n, 4) array
        Of each frame, theta [rad]; and of its own focal length, where it has one, in units of the
        lens's scale.
    point : (k, 2) array
        Of each unknown direction, along two tangents [rad].
    """

    camera: Array
    attitude: Array
    point: Array


class PointRows(NamedTuple):
    """The m spots of unknown direction.

    Attributes
    ----------
    frame, point : (m,) int array
        Where each is seen, and what.
    size : int
        Number of directions.
    H_d, H_a, H_c : (m, 2, k) array
        Derivatives by the direction, the attitude and the camera, in sigmas.
    z : (m, 2) array
        Minus the residual, in sigmas.
    """

    frame: Ints
    point: Ints
    size: int
    H_d: Array
    H_a: Array
    H_c: Array
    z: Array


class NormalEquations:
    """The normal equations of one state, attitudes eliminated, Eq. (B.2)."""

    def __init__(self, N_aa: Array, N_ac: Array, b_a: Array, N_cc: Array, b_c: Array, free: Mask,
                 scale: Array, points: PointRows) -> None:
        # Whitened by the attitude block, N_xa N_aa^-1 N_ax is a square.
        self._L = np.linalg.cholesky(N_aa)
        whitened = np.linalg.solve(self._L, np.concatenate((N_ac, b_a[..., None]), axis=-1))
        self._ac, self._a = whitened[..., :-1], whitened[..., -1]
        self._S = N_cc - np.einsum('nij,nik->jk', self._ac, self._ac)
        self._b = b_c - np.einsum('nij,ni->j', self._ac, self._a)
        self._free, self._scale, self._p = free, scale, points.size
        if points.size:
            self._with_points(points)

    def _with_points(self, points: PointRows) -> None:
        from scipy import sparse
        from scipy.sparse.linalg import splu
        n, p = len(self._L), points.size
        pairs = np.swapaxes(points.H_d, -1, -2)
        N_dd = np.zeros((p, 2, 2))
        np.add.at(N_dd, points.point, pairs @ points.H_d)
        N_dd[~N_dd.any(axis=(1, 2))] = np.eye(2)        # all of its spots left out: it stays
        N_dc, b_d = np.zeros((p, 2, self._S.shape[0])), np.zeros((p, 2))
        np.add.at(N_dc, points.point, pairs @ points.H_c)
        np.add.at(b_d, points.point, (pairs @ points.z[..., None])[..., 0])
        blocks = np.linalg.solve(self._L[points.frame],
                                 np.swapaxes(points.H_a, -1, -2) @ points.H_d)
        rows = 3 * points.frame[:, None, None] + np.arange(3)[:, None]
        columns = 2 * points.point[:, None, None] + np.arange(2)
        self._ad = sparse.coo_array(
            (blocks.ravel(), (np.broadcast_to(rows, blocks.shape).ravel(),
                              np.broadcast_to(columns, blocks.shape).ravel())),
            shape=(3 * n, 2 * p)).tocsc()
        diagonal = sparse.bsr_array((N_dd, np.arange(p), np.arange(p + 1)))
        S_dd = diagonal - self._ad.T @ self._ad
        self._factor = splu(S_dd.tocsc(), diag_pivot_thresh=0.0, options={'SymmetricMode': True})
        ac = self._ac.reshape(3 * n, -1)
        self._dc = N_dc.reshape(2 * p, -1) - self._ad.T @ ac
        self._d = b_d.reshape(-1) - self._ad.T @ self._a.reshape(-1)
        self._S = self._S - self._dc.T @ self._factor.solve(self._dc)
        self._b = self._b - self._dc.T @ self._factor.solve(self._d)

    def solve(self) -> BundleStep:
        """Return the error of the state."""
        c = np.linalg.solve(self._S, self._b)
        d = np.empty(0)
        a = self._a - self._ac @ c
        if self._p:
            d = self._factor.solve(self._d - self._dc @ c)
            a = a - (self._ad @ d).reshape(-1, 3)
        attitude = np.linalg.solve(np.swapaxes(self._L, -1, -2), a[..., None])[..., 0]
        step = np.zeros(len(self._free))
        step[self._free] = c * self._scale[self._free]
        return BundleStep(step, attitude, d.reshape(-1, 2))

    def camera_covariance(self) -> Array:
        """Return the covariance of the intrinsics, (p, p)."""
        scale = self._scale[self._free]
        covariance = np.zeros((len(self._free),) * 2)
        covariance[np.ix_(self._free, self._free)] = _inverse(self._S) * np.outer(scale, scale)
        return covariance

    def own_covariance(self) -> tuple[Array, Array]:
        """Return the covariances of the focal lengths of the frames, Eq. (B.3).

        Returns
        -------
        of_frames : (n, n) array
            Of each with each, in the unit of the lens.
        with_camera : (n, p) array
            With the intrinsics.
        """
        unit, scale = np.zeros((4, 1)), self._scale[self._free]
        unit[3] = 1.0
        whitened = np.linalg.solve(self._L, np.broadcast_to(unit, (len(self._L), 4, 1)))[..., 0]
        g = np.einsum('ni,nij->nj', whitened, self._ac)
        shared, f = g @ _inverse(self._S), self._scale[FOCAL]
        with_camera = np.zeros((len(g), len(self._free)))
        with_camera[:, self._free] = -f * shared * scale
        return (np.diag(np.sum(whitened**2, axis=1)) + shared @ g.T) * f**2, with_camera


def _inverse(information: Array) -> Array:
    """Return a covariance, positive however little is known of a part of it."""
    values, V = np.linalg.eigh(information)
    if not len(values) or values[0] > _SINGULAR * values[-1]:
        return np.asarray(np.linalg.inv(information))
    return np.asarray((V / np.maximum(values, _ROUNDING * values[-1])) @ V.T)
