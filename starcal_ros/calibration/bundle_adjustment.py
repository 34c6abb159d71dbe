# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bundle adjustment: one camera, an attitude a frame, directions known or not, all at once.

Model
-----
A spot of frame k at the direction u, known from the catalogue or a point of its own ::

    uv_m = project(C_k u, intrinsics) + sigma n,      n ~ N(0, I)                        (B.1)

The unknowns are the intrinsics that are free, all C_k and the unknown directions. Least squares
of the centroids is then the maximum likelihood estimate, by Gauss and Newton with the attitude
errors theta (``C_k <- exp(-theta) C_k``) eliminated frame by frame: with the normal blocks N of
attitudes a, points d and camera c ::

    S = N_xx - N_xa N_aa^-1 N_ax,      x = (c, d)                                        (B.2)

Where no direction is known the frames hang together by the points alone; one frame of each group
that hangs together keeps its attitude, which costs nothing but the choice of axes.

A lens that moves from image to image, by an autofocus, has a focal length of its own in each: it
joins the attitude of the frame in a, with ``f_k = f + d_k``, ``d_k ~ N(0, own_sigma^2)`` about the
focal length of the prior. That of the camera is then the mean of all f_k: with g_k the row of
``N_aa^-1 N_ac`` that belongs to f_k ::

    cov(f_k, f_l) = [k = l] (N_aa^-1)_ff + g_k S^-1 g_l',   cov(c, f_k) = -S^-1 g_k'      (B.3)

Wrong spots get Geman and McClure's weight until the fit rests, then those outside the gate are
left out. After Triggs et al., *Bundle Adjustment: A Modern Synthesis*, 2000.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from starcal_ros.core import robust, rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.units import ARCSEC

_F = 2                  # of the values of every lens model

MIN_STARS = 2
"""Observations that a frame must have: two fix its attitude."""

_ITERATIONS = 50
_CONVERGED = 1e-3       # of a sigma; the error left is the square of that
_OWN_CONVERGED = 1e-6   # of the unit of the focal length: a hundred-thousandth of a pixel
_HALVINGS = 8
_BEHIND_PX = 1e6        # residual of a star that the camera can not see: no weight is left
_WIDTH = 3.0            # of the robust weight
_SINGULAR, _ROUNDING = 1e-10, 1e-16     # least eigenvalue over the largest
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


@dataclass(frozen=True)
class Adjusted:
    """What fits best.

    Attributes
    ----------
    intrinsics : (p,) array
        Camera: the values of its lens model.
    covariance : (p, p) array
        Of its errors for the stated sigmas; zero where not free.
    C_si : (n, 3, 3) array
        Attitude of each frame.
    points : (p, 3) array
        Unit vectors of the unknown directions, in the axes of C_si.
    residual : (m, 2) array
        Measured minus predicted centroid [px].
    used : (m,) bool array
        Observations inside the gate.
    scale : float
        Size of the residuals of the spots used over what the stated sigmas promise.
    freedom : int
        Numbers of the spots used, less what was fitted to them.
    own_f : (n, 2) array or None
        Focal length of each frame and its sigma, Eq. (B.3), where each has its own; that of
        `intrinsics` is their mean.
    """

    intrinsics: Array
    covariance: Array
    C_si: Array
    points: Array
    residual: Array
    used: Mask
    scale: float
    freedom: int
    own_f: Array | None = None

    def intrinsics_of(self, frame: Ints) -> Array:
        """Return the camera (m, p) of some frames (m)."""
        every = np.tile(self.intrinsics, (len(frame), 1))
        if self.own_f is not None:
            every[:, _F] = self.own_f[frame, 0]
        return every


def adjust(spots: Observations, intrinsics: Array, C_si: Array, points: Array, lens: LensModel,
           prior_covariance: Array, gate: float, own_f_sigma: float = 0.0,
           widths: Sequence[float] = (_WIDTH,), mean: Array | None = None,
           iterations: int = _ITERATIONS) -> Adjusted:
    """Fit camera, attitudes and unknown directions.

    Parameters
    ----------
    spots : Observations
    intrinsics : (p,) array
        Where to begin.
    C_si : (n, 3, 3) array
        Where to begin.
    points : (p, 3) array
        Where to begin; each is seen in two frames at least.
    lens : LensModel
        What the camera is.
    prior_covariance : (p, p) array
        Of the prior; an intrinsic of variance 0 is held.
    gate : float
        Largest chi-square of a spot, two degrees of freedom, in units of the residuals' scale.
    own_f_sigma : float
        By how much the focal length of each frame may differ from the prior's mean, where each
        has its own, in the unit of the lens; 0 where all have the camera's. All directions are
        known then.
    widths : sequence of float
        Of the robust weight, one fit after the other; wide ones first where the start may be so
        far off that most of the field would count for wrong spots.
    mean : (p,) array, optional
        Of the prior; where it begins unless it is given.
    iterations : int
        For each width, at most.
    """
    mean = intrinsics if mean is None else mean
    own = np.zeros(len(C_si))
    if own_f_sigma:     # told from the mean of the prior, which stays
        own += intrinsics[_F] - mean[_F]
        intrinsics = np.concatenate((intrinsics[:_F], mean[_F:_F + 1], intrinsics[_F + 1:]))
    problem = _Problem(spots, mean, lens, prior_covariance, own_f_sigma)
    state = _State(intrinsics, C_si, points, own)
    used: Mask = np.ones(len(spots.frame), bool)
    for width in widths[:-1]:
        state, _ = _settle(problem, state, used, width, iterations)
    for last in (widths[-1], None):
        state, scale = _settle(problem, state, used, last, iterations)
        residual = problem.residual(state)
        length = np.linalg.norm(residual, axis=-1) / spots.sigma
        used = _enough(spots.frame, length**2 <= gate * scale**2)
    weight = np.where(used, 1.0 / spots.sigma, 0.0)
    normal = problem.normal(state, weight)
    found = Adjusted(state.intrinsics, normal.camera_covariance(), state.C_si, state.points,
                     residual, used, scale, problem.freedom(used))
    return _with_own(found, state, normal) if own_f_sigma else found


def _with_own(found: Adjusted, state: _State, normal: _Normal) -> Adjusted:
    """Return what fits best with the focal lengths of the frames, and their mean."""
    of_frames, with_camera = normal.own_covariance()
    intrinsics, covariance = found.intrinsics.copy(), found.covariance.copy()
    own = intrinsics[_F] + state.own
    intrinsics[_F] = own.mean()
    covariance[_F, :] = covariance[:, _F] = with_camera.mean(axis=0)
    covariance[_F, _F] = of_frames.mean()
    return replace(found, intrinsics=intrinsics, covariance=covariance,
                   own_f=np.stack((own, np.sqrt(np.diag(of_frames))), axis=-1))


class _State(NamedTuple):
    intrinsics: Array
    C_si: Array
    points: Array
    own: Array = np.empty(0)    # by how much the focal length of a frame is not the prior's


def _settle(problem: _Problem, state: _State, used: Mask, width: float | None,
            iterations: int) -> tuple[_State, float]:
    """Iterate to the minimum; return it and the scale of the residuals.

    All spots used count alike where there is no width.
    """
    sigma = problem.spots.sigma
    residual = problem.residual(state)
    scale = 1.0
    for _ in range(iterations):
        length = np.linalg.norm(residual, axis=-1) / sigma
        scale = max(robust.scale_of(length[used]), 1e-9)
        weight = np.where(used, 1.0 / sigma, 0.0)
        if width is not None:
            weight = weight / robust.sigma_factor(length, scale, width)
        normal = problem.normal(state, weight, residual)
        step = normal.solve()
        cost = _cost(residual, weight, problem, state)
        for _ in range(_HALVINGS):
            moved = problem.moved(state, step)
            residual = problem.residual(moved)
            if _cost(residual, weight, problem, moved) <= cost:
                break
            step = _Step(*(0.5 * part for part in step))
        state = moved
        sigmas = np.sqrt(np.diag(normal.camera_covariance()))
        if (np.abs(step.camera) <= _CONVERGED * sigmas).all() and (np.abs(
                step.attitude[:, :3]).max() < 1e-3 * ARCSEC and np.abs(
                step.attitude[:, 3:]).max(initial=0.0) < _OWN_CONVERGED):
            break
    return state, scale


def _cost(residual: Array, weight: Array, problem: _Problem, state: _State) -> float:
    misfit = np.sum((residual * weight[:, None])**2)
    return float(misfit + np.sum((problem.prior @ problem.offset(state))**2)
                 + problem.own_information * np.sum((state.own / problem.own_unit)**2))


def _enough(frame: Ints, used: Mask) -> Mask:
    """Leave out the frames of which too little is left."""
    count = np.bincount(frame, used)
    return used & (count[frame] >= MIN_STARS)


class _Step(NamedTuple):
    camera: Array
    attitude: Array
    point: Array


class _Problem:
    """The spots and the prior; residuals and normal equations of a state."""

    def __init__(self, spots: Observations, mean: Array, lens: LensModel,
                 prior_covariance: Array, own_f_sigma: float = 0.0) -> None:
        self.spots, self.mean, self.lens = spots, mean, lens
        self.free = np.diag(prior_covariance) > 0.0
        self.own_information, self.own_unit = 0.0, float(lens.scale[_F])
        if own_f_sigma:
            self.free[_F] = False
            self.own_information = (self.own_unit / own_f_sigma)**2
        self.scale = lens.scale[self.free]
        block = prior_covariance[np.ix_(self.free, self.free)] / np.outer(self.scale, self.scale)
        self.prior = np.linalg.inv(np.linalg.cholesky(block))       # a root of the information
        self.first = np.flatnonzero(np.diff(spots.frame, prepend=-1))
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

    def offset(self, state: _State) -> Array:
        """Return how far the free intrinsics are from the prior's mean, in units of SCALE."""
        return (state.intrinsics - self.mean)[self.free] / self.scale

    def directions(self, state: _State) -> Array:
        if self.known.all():
            return self.spots.u_i
        return np.where(self.known[:, None], self.spots.u_i, state.points[self.spots.point])

    def sight(self, state: _State) -> tuple[Array, Mask]:
        """Return the directions in s, and which lie ahead; others become the boresight."""
        u = self.directions(state)
        r_s = (state.C_si[self.spots.frame] @ u[..., None])[..., 0]
        ahead = self.lens.ahead(r_s)
        return np.where(ahead[:, None], r_s, (0.0, 0.0, 1.0)), ahead

    def cameras(self, state: _State) -> Array:
        """Return the camera, (p,), or that of each spot, (m, p)."""
        if not self.own_information:
            return state.intrinsics
        every = np.tile(state.intrinsics, (len(self.spots.frame), 1))
        every[:, _F] += state.own[self.spots.frame]
        return every

    def residual(self, state: _State) -> Array:
        r_s, ahead = self.sight(state)
        uv = self.lens.project(r_s[:, None], self.cameras(state))[:, 0]
        return np.where(ahead[:, None], self.spots.uv - uv, _BEHIND_PX)

    def moved(self, state: _State, step: _Step) -> _State:
        """Return the state freed of an error."""
        points = state.points
        if len(points):
            points = points - (_tangent(points) @ step.point[..., None])[..., 0]
            points /= np.linalg.norm(points, axis=-1, keepdims=True)
        own = step.attitude[:, 3] * self.own_unit if self.own_information else 0.0
        return _State(state.intrinsics - step.camera,
                      rotation.orthonormalized(rotation.exp(-step.attitude[:, :3]) @ state.C_si),
                      points, state.own - own)

    def normal(self, state: _State, weight: Array, residual: Array | None = None) -> _Normal:
        spots, p = self.spots, len(state.points)
        r_s, _ = self.sight(state)
        _, H_a, H_c = (each[:, 0] for each in self.lens.linearize(
            r_s[:, None], self.cameras(state)))
        w = weight[:, None, None]
        if self.own_information:
            H_a = np.concatenate((H_a, H_c[..., _F:_F + 1] * self.own_unit), axis=-1)
        H_a, H_c = w * H_a, w * H_c[..., self.free] * self.scale
        z = np.zeros((len(weight), 2)) if residual is None else -residual * weight[:, None]

        def per_frame(left: Array, right: Array) -> Array:
            return np.add.reduceat(np.swapaxes(left, -1, -2) @ right, self.first, axis=0)

        N_aa, b_a = per_frame(H_a, H_a), per_frame(H_a, z[..., None])[..., 0]
        if self.own_information:
            N_aa[:, 3, 3] += self.own_information
            b_a[:, 3] += self.own_information * state.own / self.own_unit
        else:
            N_aa[self.pinned] += np.eye(3) / _PINNED**2
        known = self.prior.T @ self.prior
        rows = H_c.reshape(2 * len(weight), len(self.scale))
        N_cc = rows.T @ rows + known
        b_c = rows.T @ z.reshape(-1) + known @ self.offset(state)
        d = np.flatnonzero(~self.known)
        H_d = np.empty((0, 2, 2))
        if p:
            T = state.C_si[spots.frame[d]] @ _tangent(state.points[spots.point[d]])
            # A rotation by r x dr moves r by dr.
            H_d = H_a[d] @ np.cross(r_s[d, :, None], T, axis=1)
        return _Normal(N_aa, per_frame(H_a, H_c), b_a, N_cc, b_c, self.free, self.lens.scale,
                       _Points(spots.frame[d], spots.point[d], p, H_d, H_a[d], H_c[d], z[d]))


class _Points(NamedTuple):
    """The rows of the spots of unknown direction."""

    frame: Ints
    point: Ints
    size: int
    H_d: Array
    H_a: Array
    H_c: Array
    z: Array


class _Normal:
    """The normal equations of one state, attitudes eliminated, Eq. (B.2)."""

    def __init__(self, N_aa: Array, N_ac: Array, b_a: Array, N_cc: Array, b_c: Array, free: Mask,
                 scale: Array, points: _Points) -> None:
        # Whitened by the attitude block, N_xa N_aa^-1 N_ax is a square.
        self._L = np.linalg.cholesky(N_aa)
        whitened = np.linalg.solve(self._L, np.concatenate((N_ac, b_a[..., None]), axis=-1))
        self._ac, self._a = whitened[..., :-1], whitened[..., -1]
        self._S = N_cc - np.einsum('nij,nik->jk', self._ac, self._ac)
        self._b = b_c - np.einsum('nij,ni->j', self._ac, self._a)
        self._free, self._scale, self._p = free, scale, points.size
        if points.size:
            self._with_points(points)

    def _with_points(self, points: _Points) -> None:
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

    def solve(self) -> _Step:
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
        return _Step(step, attitude, d.reshape(-1, 2))

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
        shared, f = g @ _inverse(self._S), self._scale[_F]
        with_camera = np.zeros((len(g), len(self._free)))
        with_camera[:, self._free] = -f * shared * scale
        return (np.diag(np.sum(whitened**2, axis=1)) + shared @ g.T) * f**2, with_camera


def _inverse(information: Array) -> Array:
    """Return a covariance, positive however little is known of a part of it."""
    values, V = np.linalg.eigh(information)
    if not len(values) or values[0] > _SINGULAR * values[-1]:
        return np.asarray(np.linalg.inv(information))
    return np.asarray((V / np.maximum(values, _ROUNDING * values[-1])) @ V.T)


def _tangent(u: Array) -> Array:
    """Return two unit vectors square to unit vectors u, (..., 3, 2)."""
    least = np.eye(3)[np.argmin(np.abs(u), axis=-1)]
    first = np.cross(u, least)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack((first, np.cross(u, first)), axis=-1)
