# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How well a calibration tells where a direction falls on the detector, and the reverse.

Model
-----
To first order an error d of the camera and a rotation Psi in s move the place of a direction by ::

    duv = J d + H Psi                                                                   (P.1)

Camera alone: a turn of all directions is no error of the camera, and is taken for attitude; what
is left is ``duv = (J - H H^+ J) d``, H^+ over the whole detector. With the mounting, the direction
in which the gyro axes have a pixel is off by the rotation, at a right angle to it, of ::

    theta = -H_k^+ (J_k d + H_k Psi),   H_k, J_k of that pixel alone                    (P.2)

since what stands still on the detector is ``0 = J_k d + H_k (Psi + theta)``. The attitude of the
gyro axes themselves is no part of it.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core import camera
from starcal_ros.core.arrays import Array
from starcal_ros.core.lenses.model import LensModel


def sigma_px(uv: Array, values: Array, covariance: Array, lens: LensModel) -> Array:
    """Return the standard deviation of the place of a direction, each axis, (n,) [px].

    NaN where the lens has no direction.

    Parameters
    ----------
    uv : (n, 2) array
        Places, spread over the detector [px from its centre].
    values : (p,) array
        Camera.
    covariance : (p, p) array
        Of it.
    lens : LensModel
        What it is.
    """
    sigma = np.full(len(uv), np.nan)
    with np.errstate(invalid='ignore'):
        r_s = lens.unproject(uv, values)
        seen = np.isfinite(r_s).all(axis=-1) & lens.ahead(r_s)
    _, H, J = lens.linearize(r_s[seen], values)
    H, J = H.reshape(-1, 3), J.reshape(-1, len(values))
    J = J - H @ np.linalg.lstsq(H, J, rcond=None)[0]
    variance = np.einsum('ij,jk,ik->i', J, covariance, J).reshape(-1, 2)
    sigma[seen] = np.sqrt(variance.mean(axis=-1))
    return sigma


def sigma_direction(uv: Array, intrinsics: Array, covariance: Array, pitch_mm: float) -> Array:
    """Return the standard deviation of the direction of pixels in the gyro axes, (n,) [rad].

    Each of the two axes at a right angle to the direction, Eq. (P.2).

    Parameters
    ----------
    uv : (n, 2) array
        Places [px from the centre of the detector].
    intrinsics : (7,) array
        Camera, as in `starcal_ros.core.camera`.
    pitch_mm : float
        Pixel pitch [mm].
    covariance : (10, 10) array
        Of the mounting, a rotation in s [rad], and the camera.
    """
    _, H, J = camera.linearize(
        camera.unproject(uv, intrinsics, pitch_mm), intrinsics, pitch_mm)
    theta = np.linalg.pinv(H) @ np.concatenate((H, J), axis=-1)
    variance = np.einsum('nij,jk,nik->n', theta, covariance, theta)
    return np.sqrt(0.5 * variance)
