# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Spots to stars where attitude and camera are known roughly: a gate, one to one, and a fit.

Model
-----
A view is what is believed of one frame: attitude and camera, with the covariance of their
errors ``[Psi, u0, v0, f, ...]``, the camera's those of the values of its lens model, estimate
minus truth. A star of the catalogue is
expected at uv, and a spot z is its image if ::

    (z - uv)' S^-1 (z - uv) < GATE,    S = H P H' + sigma^2 I                      (I.1)

and neither is another star within the gate of that spot nor another spot within the gate of that
star: where two may be meant, none is taken. `fitted` then moves the view to where the stars that
were found say, by an iterated Kalman update (Gauss-Newton with P as the prior).

How much of it may be chance: of n spots thrown at random on a detector of area A, the number that
fall into gates of the areas a_k is Poisson's with the mean n sum(a_k) / A             (I.2)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core import kalman, robust, rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.camera import Detector
from starcal_ros.core.distributions import chi2_ppf_of_two, poisson_sf
from starcal_ros.core.lenses.model import LensModel

Rows = Ints

GATE = chi2_ppf_of_two(0.999)
"""Chi-square of two degrees of freedom that one image of a star in a thousand exceeds."""

_ITERATIONS = 5
_WIDTH = 3.0            # of the robust weight


class View(NamedTuple):
    """What is believed of the attitude and the camera of one frame.

    Attributes
    ----------
    C_si : (3, 3) array
        Attitude of the star tracker.
    intrinsics : (p,) array
        Camera: the values of its lens model.
    root : (3 + p, 3 + p) array
        Root of the covariance of their errors: Psi in s [rad], then the intrinsics.
    """

    C_si: Array
    intrinsics: Array
    root: Array

    @classmethod
    def around(cls, C_si: Array, attitude_covariance: Array, intrinsics: Array,
               camera_covariance: Array) -> View:
        """Return the view with independent errors of attitude (3, 3) and camera (p, p)."""
        root = np.zeros((3 + len(intrinsics),) * 2)
        root[:3, :3] = kalman.root_of(attitude_covariance)
        root[3:, 3:] = kalman.root_of(camera_covariance)
        return cls(C_si, intrinsics, root)

    def moved(self, error: Array) -> View:
        """Return the view less an error (3 + p,)."""
        return self._replace(C_si=rotation.exp(-error[:3]) @ self.C_si,
                             intrinsics=self.intrinsics - error[3:])

    def minus(self, other: View) -> Array:
        """Return the difference of two views as an error (3 + p,)."""
        return np.concatenate((rotation.log(self.C_si @ other.C_si.T),
                               self.intrinsics - other.intrinsics))


class Expected(NamedTuple):
    """Where the stars of the catalogue should be.

    Attributes
    ----------
    uv : (n, 2) array
        Their images, from the centre of the detector [px].
    H : (n, 2, 3 + p) array
        Derivatives by the errors of the view.
    P : (n, 2, 2) array
        Covariance of uv [px^2].
    """

    uv: Array
    H: Array
    P: Array

    def take(self, rows: Mask) -> Expected:
        """Return some of them."""
        return Expected(self.uv[rows], self.H[rows], self.P[rows])

    def told(self, sigma_px: float) -> Mask:
        """Tell which are known to a standard deviation, of both axes together [px]."""
        return np.asarray(np.trace(self.P, axis1=-2, axis2=-1) < 2.0 * sigma_px**2)


def expected(view: View, u_i: Array, lens: LensModel) -> Expected:
    """Return the images of the stars u_i (n, 3), all of which the lens can see."""
    uv, H_rotation, H_camera = lens.linearize(u_i @ view.C_si.T, view.intrinsics)
    H = np.concatenate((H_rotation, H_camera), axis=-1)
    M = H @ view.root
    return Expected(uv, H, M @ np.swapaxes(M, -1, -2))


def match(stars: Expected, uv: Array, sigma: Array) -> tuple[Rows, Rows]:
    """Return which spot is which star, by Eq. (I.1), one to one.

    Parameters
    ----------
    stars : Expected
        The catalogue, n stars.
    uv : (m, 2) array
        Spots, from the centre of the detector [px].
    sigma : (m,) array
        Standard deviation of a spot about its star's image, each axis [px].

    Returns
    -------
    spot, star : (k,) int64 array
        Rows that belong together.
    """
    z = uv[:, None] - stars.uv
    z_u, z_v, variance = z[..., 0], z[..., 1], sigma[:, None]**2
    S_uu, S_uv, S_vv = (stars.P[:, 0, 0] + variance, stars.P[:, 0, 1],
                        stars.P[:, 1, 1] + variance)
    inside = (S_vv * z_u**2 - 2.0 * S_uv * z_u * z_v + S_uu * z_v**2
              < GATE * (S_uu * S_vv - S_uv**2))
    alone = inside & (inside.sum(axis=0) == 1) & (inside.sum(axis=1) == 1)[:, None]
    spot, star = np.nonzero(alone)
    return spot, star


def fitted(prior: View, u_i: Array, uv: Array, sigma: Array, lens: LensModel) -> View:
    """Return the view that prior and most stars (n) agree on, and its covariance."""
    view = prior
    for _ in range(_ITERATIONS):
        stars, deviation = expected(view, u_i, lens), view.minus(prior)
        miss = np.linalg.norm(stars.uv - uv, axis=-1)
        scale = np.maximum(robust.scale_of(miss), sigma)
        innovation = kalman.innovate(prior.root, stars.H,
                                     stars.uv - uv - stars.H @ deviation,
                                     sigma * robust.sigma_factor(miss, scale, _WIDTH))
        error, root, _ = kalman.correct(prior.root, innovation, np.ones(len(uv), bool))
        view = prior.moved(error)._replace(root=root)
    return view


def chance(matched: int, spots: int, stars: Expected, sigma: float, detector: Detector) -> float:
    """Return how probable it is that random spots give as many matches, Eq. (I.2).

    Parameters
    ----------
    matched, spots : int
        Spots that were matched, less those that the attitude itself was made of; all spots.
    stars : Expected
        Stars that they might have matched.
    sigma : float
        Standard deviation of a spot about its star's image [px].
    detector : Detector
        Its area.
    """
    S = stars.P + sigma**2 * np.eye(2)
    area = np.pi * GATE * np.sqrt(np.linalg.det(S)).sum()
    return float(poisson_sf(matched - 1, spots * area / (detector.width * detector.height)))
