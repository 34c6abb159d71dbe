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
left out. After Triggs et al., *Bundle Adjustment: A Modern Synthesis*, 2000. `bundle_problem` has
the spots and (B.1), `normal_equations` has (B.2) and (B.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from starcal_ros.calibration.bundle_problem import (MIN_STARS, BundleProblem, BundleState,
                                                    Observations, SeenSpots)
from starcal_ros.calibration.normal_equations import FOCAL, BundleStep, NormalEquations
from starcal_ros.core import robust
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.units import ARCSEC

_ITERATIONS = 50
_CONVERGED = 1e-3       # of a sigma; the error left is the square of that
_OWN_CONVERGED = 1e-6   # of the unit of the focal length: a hundred-thousandth of a pixel
_NEARLY = 100.0         # times that, where the next width goes on
_HALVINGS = 8
_WIDTH = 3.0            # of the robust weight


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
            every[:, FOCAL] = self.own_f[frame, 0]
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
        own += intrinsics[FOCAL] - mean[FOCAL]
        intrinsics = np.concatenate((
            intrinsics[:FOCAL], mean[FOCAL:FOCAL + 1], intrinsics[FOCAL + 1:]))
    problem = BundleProblem(spots, mean, lens, prior_covariance, own_f_sigma)
    seen = problem.look(BundleState(intrinsics, C_si, points, own))
    used: Mask = np.ones(len(spots.frame), bool)
    for width in widths[:-1]:
        seen, _ = _settle(problem, seen, used, width, iterations, _NEARLY)
    for last in (widths[-1], None):
        seen, scale = _settle(problem, seen, used, last, iterations)
        length = np.linalg.norm(seen.residual, axis=-1) / spots.sigma
        used = _enough(spots.frame, length**2 <= gate * scale**2)
    state, normal = seen.state, problem.normal(seen, np.where(used, 1.0 / spots.sigma, 0.0))
    found = Adjusted(state.intrinsics, normal.camera_covariance(), state.C_si, state.points,
                     seen.residual, used, scale, problem.freedom(used))
    return _with_own(found, state, normal) if own_f_sigma else found


def _with_own(found: Adjusted, state: BundleState, normal: NormalEquations) -> Adjusted:
    """Return what fits best with the focal lengths of the frames, and their mean."""
    of_frames, with_camera = normal.own_covariance()
    intrinsics, covariance = found.intrinsics.copy(), found.covariance.copy()
    own = intrinsics[FOCAL] + state.own
    intrinsics[FOCAL] = own.mean()
    covariance[FOCAL, :] = covariance[:, FOCAL] = with_camera.mean(axis=0)
    covariance[FOCAL, FOCAL] = of_frames.mean()
    return replace(found, intrinsics=intrinsics, covariance=covariance,
                   own_f=np.stack((own, np.sqrt(np.diag(of_frames))), axis=-1))


def _settle(problem: BundleProblem, seen: SeenSpots, used: Mask, width: float | None,
            iterations: int, ease: float = 1.0) -> tuple[SeenSpots, float]:
    """Iterate to the minimum; return it and the scale of the residuals.

    All spots used count alike where there is no width. With ease it stops so many times further
    from the minimum.
    """
    sigma = problem.spots.sigma
    scale = 1.0
    for _ in range(iterations):
        length = np.linalg.norm(seen.residual, axis=-1) / sigma
        scale = max(robust.scale_of(length[used]), 1e-9)
        weight = np.where(used, 1.0 / sigma, 0.0)
        if width is not None:
            weight = weight / robust.sigma_factor(length, scale, width)
        normal = problem.normal(seen, weight)
        step = normal.solve()
        cost = _cost(problem, seen, weight)
        for _ in range(_HALVINGS):
            moved = problem.look(problem.moved(seen.state, step))
            if _cost(problem, moved, weight) <= cost:
                break
            step = BundleStep(*(0.5 * part for part in step))
        seen = moved
        if _rests(step, normal, ease):
            break
    return seen, scale


def _rests(step: BundleStep, normal: NormalEquations, ease: float) -> bool:
    """Tell whether a step was too small to matter; the camera, which costs most, comes last."""
    return bool(
        np.abs(step.attitude[:, :3]).max() < ease * 1e-3 * ARCSEC
        and np.abs(step.attitude[:, 3:]).max(initial=0.0) < ease * _OWN_CONVERGED
        and (np.abs(step.camera) <= ease * _CONVERGED * np.sqrt(
            np.diag(normal.camera_covariance()))).all())


def _cost(problem: BundleProblem, seen: SeenSpots, weight: Array) -> float:
    misfit, state = (seen.residual * weight[:, None]).ravel(), seen.state
    return float(misfit @ misfit + np.sum((problem.prior @ problem.offset(state))**2)
                 + problem.own_information * np.sum((state.own / problem.own_unit)**2))


def _enough(frame: Ints, used: Mask) -> Mask:
    """Leave out the frames of which too little is left."""
    count = np.bincount(frame, used)
    return used & (count[frame] >= MIN_STARS)
