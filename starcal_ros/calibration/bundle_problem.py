# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a bundle adjustment is of: spots, a camera and its prior; its residuals at a state.

A state is a camera, an attitude a frame and the directions that are not known. Here are its
residuals, their linearisation, Eq. (B.1), and how an error moves it; `bundle_adjustment` has the
equations and finds the best state.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.calibration.normal_equations import FOCAL, BundleStep, NormalEquations, PointRows
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.units import ARCSEC

MIN_STARS = 2
"""Observations that a frame must have: two fix its attitude."""

_BEHIND_PX = 1e6        # residual of a star that the camera can not see: no weight is left
_PINNED = 1e-3 * ARCSEC     # sigma of an attitude that is held


class Observations(NamedTuple):
    """Measured spots, frame after frame.

    Attributes
    ----------
    frame : (m,) int array
        Frame of each spot, from 0, not decreasing; each frame has MIN_STARS at least.
    uv : (m, 2) array
        Centroids, from the centre of the detector [px].
    sigma : (m,) array
        Standard deviation, each axis [px].
    u_i : (m, 3) array
        Apparent places where they are known, else anything.
    point : (m,) int array
        Number of the unknown direction of a spot, from 0; -1 where it is known.
    """

    frame: Ints
    uv: Array
    sigma: Array
    u_i: Array
    point: Ints


class BundleState(NamedTuple):
    """What is fitted.

    Attributes
    ----------
    intrinsics : (p,) array
    C_si : (n, 3, 3) array
        Of each frame.
    points : (k, 3) array
        Unit vectors of the unknown directions.
    own : (n,) array
        By how much the focal length of a frame is not the prior's.
    """

    intrinsics: Array
    C_si: Array
    points: Array
    own: Array = np.empty(0)


class SeenSpots(NamedTuple):
    """What the spots are at a state, Eq. (B.1).

    Attributes
    ----------
    state : BundleState
    r_s : (m, 3) array
        Directions in s; the boresight where the camera can not see them.
    residual : (m, 2) array
        Measured minus predicted centroids [px].
    rows : (m, 2, k) array
        Derivatives of the predicted ones by the attitude, 3 or 4 columns, and by all intrinsics,
        and minus the residual.
    """

    state: BundleState
    r_s: Array
    residual: Array
    rows: Array


class BundleProblem:
    """The spots and the prior; residuals and normal equations of a state."""

    def __init__(self, spots: Observations, mean: Array, lens: LensModel,
                 prior_covariance: Array, own_f_sigma: float = 0.0) -> None:
        self.spots, self.mean, self.lens = spots, mean, lens
        self.free = np.diag(prior_covariance) > 0.0
        self.own_information, self.own_unit = 0.0, float(lens.scale[FOCAL])
        if own_f_sigma:
            self.free[FOCAL] = False
            self.own_information = (self.own_unit / own_f_sigma)**2
        self.columns, self.scale = np.flatnonzero(self.free), lens.scale[self.free]
        self.square = np.outer(self.scale, self.scale)
        block = prior_covariance[np.ix_(self.free, self.free)] / self.square
        self.prior = np.linalg.inv(np.linalg.cholesky(block))       # a root of the information
        self.known_before = self.prior.T @ self.prior
        self.first = np.flatnonzero(np.diff(spots.frame, prepend=-1))
        edges = (2 * np.append(self.first, len(spots.frame))).tolist()
        self.parts = [slice(*pair) for pair in zip(edges, edges[1:])]     # of u and v, in rows
        self.known = spots.point < 0
        self.pinned = self._pinned()

    def _pinned(self) -> Ints:
        """Return the frames whose attitude is held: one of each group of unknown directions."""
        spots, n = self.spots, len(self.first)
        free = np.flatnonzero(~self.known)
        if not len(free):
            return np.empty(0, np.int64)
        p = int(spots.point.max()) + 1
        from scipy import sparse
        graph = sparse.coo_array((np.ones(len(free)), (spots.frame[free], n + spots.point[free])),
                                 shape=(n + p, n + p))
        _, group = sparse.csgraph.connected_components(graph, directed=False)
        group = group[:n]
        anchored = np.unique(group[np.unique(spots.frame[self.known])])
        label, first = np.unique(group, return_index=True)
        return first[~np.isin(label, anchored)].astype(np.int64)

    def freedom(self, used: Mask) -> int:
        """Return the numbers of some spots less those of attitudes, directions and camera."""
        frames = len(np.setdiff1d(self.spots.frame[used], self.pinned))
        points = len(np.unique(self.spots.point[used & ~self.known]))
        of_frame = 4 if self.own_information else 3
        return int(2 * used.sum() - of_frame * frames - 2 * points - self.free.sum())

    def offset(self, state: BundleState) -> Array:
        """Return how far the free intrinsics are from the prior's mean, in units of `scale`."""
        return (state.intrinsics - self.mean)[self.free] / self.scale

    def directions(self, state: BundleState) -> Array:
        """Return the direction of each spot, (m, 3), in the axes of C_si."""
        if self.known.all():
            return self.spots.u_i
        return np.where(self.known[:, None], self.spots.u_i, state.points[self.spots.point])

    def cameras(self, state: BundleState) -> Array:
        """Return the camera, (p,), or that of each spot, (m, p)."""
        if not self.own_information:
            return state.intrinsics
        every = np.tile(state.intrinsics, (len(self.spots.frame), 1))
        every[:, FOCAL] += state.own[self.spots.frame]
        return every

    def look(self, state: BundleState) -> SeenSpots:
        """Return what the spots are at a state."""
        u = self.directions(state)
        r_s = np.einsum('mij,mj->mi', state.C_si[self.spots.frame], u)
        ahead = self.lens.ahead(r_s)[:, None]
        r_s = np.where(ahead, r_s, (0.0, 0.0, 1.0))
        uv, H_a, H_c = (each[:, 0] for each in self.lens.linearize(
            r_s[:, None], self.cameras(state)))
        residual = np.where(ahead, self.spots.uv - uv, _BEHIND_PX)
        own = (H_c[..., FOCAL:FOCAL + 1] * self.own_unit,) if self.own_information else ()
        return SeenSpots(state, r_s, residual,
                         np.concatenate((H_a, *own, H_c, -residual[..., None]), axis=-1))

    def moved(self, state: BundleState, step: BundleStep) -> BundleState:
        """Return the state freed of an error."""
        points = state.points
        if len(points):
            points = points - (_tangent(points) @ step.point[..., None])[..., 0]
            points /= np.linalg.norm(points, axis=-1, keepdims=True)
        own = step.attitude[:, 3] * self.own_unit if self.own_information else 0.0
        C_si = rotation.orthonormalized(rotation.exp(-step.attitude[:, :3]) @ state.C_si)
        return BundleState(state.intrinsics - step.camera, C_si, points, state.own - own)

    def normal(self, seen: SeenSpots, weight: Array) -> NormalEquations:
        """Return the normal equations, linear about a state.

        Parameters
        ----------
        seen : SeenSpots
        weight : (m,) array
            Of each spot: one over its sigma, or less [1/px].
        """
        spots, state, p = self.spots, seen.state, len(seen.state.points)
        rows = seen.rows * weight[:, None, None]
        size = rows.shape[-1] - 1 - len(self.free)      # of the block of an attitude
        flat = rows.reshape(2 * len(weight), -1)
        of_frame = np.empty((len(self.first), size, flat.shape[1]))
        for k, part in enumerate(self.parts):
            np.dot(flat[part, :size].T, flat[part], out=of_frame[k])
        of_camera = flat[:, size:].T @ flat[:, size:]
        N_aa, b_a = of_frame[..., :size], of_frame[..., -1]
        if self.own_information:
            N_aa[:, 3, 3] += self.own_information
            b_a[:, 3] += self.own_information * state.own / self.own_unit
        else:
            N_aa[self.pinned] += np.eye(3) / _PINNED**2
        N_cc = of_camera[self.columns[:, None], self.columns] * self.square + self.known_before
        b_c = of_camera[self.columns, -1] * self.scale + self.known_before @ self.offset(state)
        d = np.flatnonzero(~self.known)
        H_a, H_c, H_d = rows[d, :, :size], rows[d, :, size:-1], np.empty((0, 2, 2))
        if p:
            T = state.C_si[spots.frame[d]] @ _tangent(state.points[spots.point[d]])
            # A rotation by r x dr moves r by dr.
            H_d = H_a @ np.cross(seen.r_s[d, :, None], T, axis=1)
        return NormalEquations(
            N_aa, of_frame[..., size:-1][..., self.columns] * self.scale, b_a, N_cc, b_c,
            self.free, self.lens.scale,
            PointRows(spots.frame[d], spots.point[d], p, H_d, H_a,
                      H_c[..., self.columns] * self.scale, rows[d, :, -1]))


def _tangent(u: Array) -> Array:
    """Return two unit vectors square to unit vectors u, (..., 3, 2)."""
    least = np.eye(3)[np.argmin(np.abs(u), axis=-1)]
    first = np.cross(u, least)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack((first, np.cross(u, first)), axis=-1)
