# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Residuals of stars and their derivatives, at a camera and attitudes that were fitted."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.calibration.bundle_adjustment import Adjusted
from starcal_ros.calibration.bundle_problem import Observations
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.lenses.model import LensModel


class FittedStars(NamedTuple):
    """Stars of some frames, their attitudes fitted and the camera held.

    Attributes
    ----------
    frame : (n,) int array
        Frame of each star, not decreasing.
    uv : (n, 2) array
        Predicted centroids, from the centre of the detector [px]. The measured ones hold the very
        noise that is tested: a star at rest would seem displaced by its place in the pixel.
    sigma : (n,) array
        Standard deviation of each axis [px].
    magnitude : (n,) array
        NaN where it is not known.
    z : (n, 2) array
        Measured minus predicted centroid, in sigmas.
    by_attitude : (n, 2, 3) or (n, 2, 4) array
        d (predicted centroid) / d rotation, in sigmas; and by the focal length that a frame has
        for itself, where it has one.
    by_camera : (n, 2, p) array
        The same by the intrinsics, in units of `scale`.
    scale : (p,) array
        That of the lens model.
    rejected : int
        Stars that the gate took.
    """

    frame: Ints
    uv: Array
    sigma: Array
    magnitude: Array
    z: Array
    by_attitude: Array
    by_camera: Array
    scale: Array
    rejected: int


def fitted_stars(spots: Observations, adjusted: Adjusted, magnitude: Array, lens: LensModel
                 ) -> FittedStars:
    """Return the stars inside the gate, linearised at their camera.

    Parameters
    ----------
    spots : Observations
        Of known direction.
    adjusted : Adjusted
        Their fit.
    magnitude : (m,) array
        Of each spot, NaN where it is not known.
    lens : LensModel
        What the camera is.
    """
    used = adjusted.used
    frame, sigma = spots.frame[used], spots.sigma[used]
    r_s = adjusted.C_si[frame] @ spots.u_i[used][..., None]
    uv, by_attitude, by_camera = (each[:, 0] for each in lens.linearize(
        np.swapaxes(r_s, 1, 2), adjusted.intrinsics_of(frame)))
    weight = (1.0 / sigma)[:, None, None]
    by_attitude, by_camera = weight * by_attitude, weight * by_camera * lens.scale
    if adjusted.own_f is not None:       # it goes with the attitude
        by_attitude = np.concatenate((by_attitude, by_camera[..., 2:3]), axis=-1)
        by_camera[..., 2] = 0.0
    return FittedStars(
        frame, uv, sigma, magnitude[used], adjusted.residual[used] / sigma[:, None],
        by_attitude, by_camera, lens.scale, int((~used).sum()))
