# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The cameras of W19 and S24, to and from the project's camera.

W19, Wu et al. 2019
-------------------
Six parameters ``[s, f, u0, v0, k1, k2]``: aspect ratio of a pixel, focal length [mm], principal
point [raster px], and distortion without unit. With the pixel's width D_u [mm], D_v = s D_u, and
the optical axes o, in which r_o = (a, b, 1) Z ::

    r^2 = a^2 + b^2,    m = 1 + k1 r^2 + k2 r^4                          (W19 Eq. 7, 5, 6)
    u = u0 + (f / D_u) a m,    v = v0 + (f / D_v) b m                    (W19 Eq. 1 to 4)

On the raster (u, s v), which has square pixels of width D_u, this is the project's camera with ::

    u0, s v0,  f,  k1_project = k1 / f^2,  k2_project = k2 / f^4,  p1 = p2 = 0          (C.1)

Eq. 6 as printed multiplies u itself, which W19 counts from the corner of the image, and not the
distance u - u0 from the principal point. That can not be meant: the image would be stretched about
its corner by a factor that depends on the distance from its middle. W19's k1 = -0.5 would move a
star in the far corner by 40 px and one in the corner at the origin not at all, which no lens does:
it is round about its axis. Here it is the distance. (W19's own numbers do not decide it: its Table
2 agrees with itself in neither form, see docs/attitude_free.md.)

S24
---
A pinhole: ``[x0, y0, f]``, principal point [raster px] and focal length [mm]; the project's camera
without distortion.

Raster pixels are the project's, (0, 0) the centre of the top-left pixel; neither paper says where
in that pixel its origin is. An image is the same whatever the axes: where the paper writes a
direction in o, the functions here take and give it in s, and r_o = Rz(180 deg) r_s.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.calibration.invariants import Square
from starcal_ros.core import camera
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import INTRINSICS, Detector

W19_PARAMETERS = ('s', 'f', 'u0', 'v0', 'k1', 'k2')
S24_PARAMETERS = ('x0', 'y0', 'f')


def from_w19(parameters: Array, detector: Detector) -> Array:
    """Return the intrinsics (..., 7) of W19's camera (..., 6), Eq. (C.1).

    Raises
    ------
    ValueError
        Where s is not 1: the project's pixels are square.
    """
    parameters = np.asarray(parameters, float)
    s = parameters[..., 0]
    if np.any(s != 1.0):
        raise ValueError(f's = {s[s != 1.0].flat[0]}: a camera with square pixels has s = 1')
    intrinsics = _square(parameters)
    intrinsics[..., :2] -= detector.centre_raster
    return intrinsics


def to_w19(intrinsics: Array, detector: Detector) -> Array:
    """Return W19's camera, (..., 6), of intrinsics (..., 7), Eq. (C.1).

    Raises
    ------
    ValueError
        Where p1 or p2 is not 0: W19 knows radial distortion alone.
    """
    intrinsics = np.asarray(intrinsics, float)
    _require_zero(intrinsics, ('p1', 'p2'), 'the camera of W19 has no tangential distortion')
    f, k1, k2 = (intrinsics[..., k] for k in (2, 3, 4))
    uv0 = intrinsics[..., :2] + detector.centre_raster
    return np.concatenate((np.stack((np.ones_like(f), f), axis=-1), uv0,
                           np.stack((k1 * f**2, k2 * f**4), axis=-1)), axis=-1)


def from_s24(parameters: Array, detector: Detector) -> Array:
    """Return the intrinsics (..., 7) of S24's pinhole (..., 3)."""
    parameters = np.asarray(parameters, float)
    uv0 = parameters[..., :2] - detector.centre_raster
    return np.concatenate((uv0, parameters[..., 2:], np.zeros((*uv0.shape[:-1], 4))), axis=-1)


def to_s24(intrinsics: Array, detector: Detector) -> Array:
    """Return S24's pinhole, (..., 3), of intrinsics (..., 7).

    Raises
    ------
    ValueError
        Where the camera distorts.
    """
    intrinsics = np.asarray(intrinsics, float)
    _require_zero(intrinsics, INTRINSICS[3:], 'the camera of S24 is a pinhole')
    return np.concatenate((intrinsics[..., :2] + detector.centre_raster, intrinsics[..., 2:3]),
                          axis=-1)


def _require_zero(intrinsics: Array, names: tuple[str, ...], why: str) -> None:
    for name in names:
        value = intrinsics[..., INTRINSICS.index(name)]
        if np.any(value != 0.0):
            raise ValueError(f'{name} = {value[value != 0.0].flat[0]}: {why}')


def project_w19(r_s: Array, parameters: Array, pitch_mm: float) -> Array:
    """Return the centroids (..., n, 2) of directions (..., n, 3) in W19's camera [raster px].

    Parameters
    ----------
    r_s : (..., n, 3) array
        Directions in s, of any length, Z > 0.
    parameters : (..., 6) array
        W19's camera.
    pitch_mm : float
        Width of a pixel, D_u [mm].
    """
    return camera.project(r_s, _square(parameters), pitch_mm) / _aspect(parameters)


def unproject_w19(uv_raster: Array, parameters: Array, pitch_mm: float, **options: int) -> Array:
    """Return the unit directions in s, (..., n, 3), of raster centroids: W19 Eq. 8.

    Options are those of `camera.unproject`.
    """
    return camera.unproject(uv_raster * _aspect(parameters), _square(parameters), pitch_mm,
                            **options)


def square_w19(parameters: Array) -> Square:
    """Return W19's camera, (..., 6), on square pixels: Eq. (C.1)."""
    scale = 1.0 / _aspect(parameters)[..., 0, :]
    scale_slopes = np.zeros((*parameters.shape[:-1], 2, 6))
    scale_slopes[..., 1, 0] = -scale[..., 1]**2
    return Square(_square(parameters), _square_slope(parameters), scale, scale_slopes)


def backproject_w19(uv_raster: Array, parameters: Array, pitch_mm: float
                    ) -> tuple[Array, Array, Array]:
    """Return `unproject_w19` and its derivatives.

    Returns
    -------
    w_s : (..., n, 3) array
        Unit directions in s.
    dw_duv : (..., n, 3, 2) array
        d w_s / d uv_raster at a fixed camera [1/px].
    dw_dparameters : (..., n, 3, 6) array
        d w_s / d parameters at fixed centroids.
    """
    aspect = _aspect(parameters)
    w_s, dw_duv, dw_square = camera.backproject(
        uv_raster * aspect, _square(parameters), pitch_mm)
    dw = _by_w19(dw_square, parameters)
    dw[..., 0] += dw_duv[..., 1] * uv_raster[..., 1, None]
    return w_s, dw_duv * aspect[..., None, :], dw


def _aspect(parameters: Array) -> Array:
    """Return the factors, (..., 1, 2), that make W19's raster square."""
    factors = np.ones((*parameters.shape[:-1], 1, 2))
    factors[..., 0, 1] = parameters[..., 0]
    return factors


def _square(parameters: Array) -> Array:
    """Return the project's camera on the square raster, (..., 7): Eq. (C.1)."""
    s, f, u0, v0, k1, k2 = (parameters[..., k] for k in range(6))
    out = np.zeros((*parameters.shape[:-1], 7))
    out[..., 0], out[..., 1], out[..., 2] = u0, s * v0, f
    out[..., 3], out[..., 4] = k1 / f**2, k2 / f**4
    return out


def _by_w19(by_square: Array, parameters: Array) -> Array:
    """Return derivatives (..., n, m, 6) from those by `_square`, (..., n, m, 7)."""
    rows = by_square.reshape(*by_square.shape[:-3], -1, 7) @ _square_slope(parameters)
    return rows.reshape(*rows.shape[:-2], *by_square.shape[-3:-1], 6)


def _square_slope(parameters: Array) -> Array:
    """Return the derivatives of `_square`, (..., 7, 6)."""
    s, f, _, v0, k1, k2 = (parameters[..., k] for k in range(6))
    slope = np.zeros((*parameters.shape[:-1], 7, 6))
    slope[..., 0, 2] = slope[..., 2, 1] = 1.0
    slope[..., 1, 0], slope[..., 1, 3] = v0, s
    slope[..., 3, 1], slope[..., 3, 4] = -2.0 * k1 / f**3, 1.0 / f**2
    slope[..., 4, 1], slope[..., 4, 5] = -4.0 * k2 / f**5, 1.0 / f**4
    return slope
