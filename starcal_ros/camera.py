# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The camera that truth and belief share: projection, distortion and their derivatives.

Model
-----
A star in direction r_s = (X, Y, Z), star tracker axes s of T18 Fig. 1, falls on the detector at ::

    x = -f X / Z,   y = -f Y / Z,   r^2 = x^2 + y^2                            (T18 Eq. 3)
    x_d = x (k1 r^2 + k2 r^4) + p1 (r^2 + 2 x^2) + 2 p2 x y                    (T18 Eq. 4)
    y_d = y (k1 r^2 + k2 r^4) + p2 (r^2 + 2 y^2) + 2 p1 x y
    u = u0 + (x + x_d) / d,   v = v0 + (y + y_d) / d

    f, x, y      mm                     focal length, undistorted image point
    d            mm                     pixel pitch
    k1 k2 p1 p2  mm^-2 mm^-4 mm^-1 mm^-1
    u, v, u0, v0 px                     from the centre of the detector

The seven intrinsics are one array (..., 7) in the order of the filter's state,
``[u0, v0, f, k1, k2, p1, p2]``; leading axes are batch axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INTRINSICS = ('u0', 'v0', 'f', 'k1', 'k2', 'p1', 'p2')
INTRINSICS_KEYS = ('u0_px', 'v0_px', 'f_mm', 'k1', 'k2', 'p1', 'p2')
"""Their names in files."""


@dataclass(frozen=True)
class Detector:
    """The part of a camera that is known: its pixels."""

    width: int
    height: int
    pitch_mm: float

    @property
    def centre_raster(self) -> Array:
        """Centre of the detector in raster pixels, (2,); (0, 0) is the top-left pixel's centre."""
        return np.array([(self.width - 1) / 2.0, (self.height - 1) / 2.0])

    def contains(self, uv: Array) -> NDArray[np.bool_]:
        """Tell which points (..., 2), from the centre of the detector [px], lie on it."""
        inside = np.abs(uv) <= np.array([self.width, self.height]) / 2.0
        return inside[..., 0] & inside[..., 1]


def project(r_s: Array, intrinsics: Array, pitch_mm: float) -> Array:
    """Return the centroids (..., n, 2) [px] of directions r_s (..., n, 3).

    Parameters
    ----------
    r_s : (..., n, 3) array
        Directions in s, of any length, Z > 0.
    intrinsics : (..., 7) array
        Camera, see the module.
    pitch_mm : float
        Pixel pitch [mm].
    """
    u0, v0, f, *lens = (intrinsics[..., k, None] for k in range(7))
    x, y = _distorted(-f * r_s[..., 0] / r_s[..., 2], -f * r_s[..., 1] / r_s[..., 2], *lens)
    return np.stack((u0 + x / pitch_mm, v0 + y / pitch_mm), axis=-1)


def _distorted(x: Array, y: Array, k1: Array, k2: Array, p1: Array, p2: Array
               ) -> tuple[Array, Array]:
    """Return the distorted image point (x + x_d, y + y_d) [mm]."""
    xx, yy, xy2 = x * x, y * y, 2.0 * x * y
    rr = xx + yy
    radial = 1.0 + rr * (k1 + k2 * rr)
    return (x * radial + p1 * (rr + 2.0 * xx) + p2 * xy2,
            y * radial + p2 * (rr + 2.0 * yy) + p1 * xy2)


def _distorted_slope(x: Array, y: Array, k1: Array, k2: Array, p1: Array, p2: Array
                     ) -> tuple[Array, Array, Array]:
    """Return the derivatives xx, xy = yx, yy of `_distorted` by (x, y)."""
    xx, yy = x * x, y * y
    rr = xx + yy
    radial, bend = 1.0 + rr * (k1 + k2 * rr), 2.0 * (k1 + 2.0 * k2 * rr)
    p1_x, p1_y, p2_x, p2_y = 2.0 * p1 * x, 2.0 * p1 * y, 2.0 * p2 * x, 2.0 * p2 * y
    return (radial + bend * xx + 3.0 * p1_x + p2_y,
            bend * x * y + p1_y + p2_x,
            radial + bend * yy + 3.0 * p2_y + p1_x)


def linearize(r_s: Array, intrinsics: Array, pitch_mm: float) -> tuple[Array, Array, Array]:
    """Return the centroids and their derivatives.

    Parameters
    ----------
    r_s, intrinsics, pitch_mm
        As for `project`.

    Returns
    -------
    uv : (..., n, 2) array
        Centroids [px].
    H_rotation : (..., n, 2, 3) array
        d uv / d Psi for r_s -> (I + [Psi x]) r_s [px/rad]; T18 Eq. 15, the terms with A.
    H_intrinsics : (..., n, 2, 7) array
        d uv / d intrinsics; T18 Eq. 24, the last seven columns, for the distortion evaluated at
        the undistorted point.
    """
    u0, v0, f, *lens = (intrinsics[..., k, None] for k in range(7))
    scale = 1.0 / pitch_mm
    a, b = r_s[..., 0] / r_s[..., 2], r_s[..., 1] / r_s[..., 2]
    x, y = -f * a, -f * b
    uv = np.empty((*x.shape, 2))
    x_distorted, y_distorted = _distorted(x, y, *lens)
    uv[..., 0], uv[..., 1] = u0 + scale * x_distorted, v0 + scale * y_distorted
    D_xx, D_xy, D_yy = (scale * slope for slope in _distorted_slope(x, y, *lens))

    # d(a, b) / d Psi = [[-a b, 1 + a^2, -b], [-(1 + b^2), a b, a]], and x = -f a, y = -f b.
    H_rotation = np.empty((*x.shape, 2, 3))
    f_ab, f_aa, f_bb = f * a * b, -f * (1.0 + a * a), f * (1.0 + b * b)
    H_rotation[..., 0, 0] = D_xx * f_ab + D_xy * f_bb
    H_rotation[..., 1, 0] = D_xy * f_ab + D_yy * f_bb
    H_rotation[..., 0, 1] = D_xx * f_aa - D_xy * f_ab
    H_rotation[..., 1, 1] = D_xy * f_aa - D_yy * f_ab
    H_rotation[..., 0, 2] = D_xy * x - D_xx * y
    H_rotation[..., 1, 2] = D_yy * x - D_xy * y

    H_intrinsics = np.zeros((*x.shape, 2, 7))
    H_intrinsics[..., 0, 0] = H_intrinsics[..., 1, 1] = 1.0
    H_intrinsics[..., 0, 2] = -(D_xx * a + D_xy * b)
    H_intrinsics[..., 1, 2] = -(D_xy * a + D_yy * b)
    xx, yy = scale * x * x, scale * y * y
    rr = xx + yy
    H_intrinsics[..., 0, 3] = k1_x = x * rr
    H_intrinsics[..., 1, 3] = k1_y = y * rr
    H_intrinsics[..., 0, 4] = k1_x * rr * pitch_mm
    H_intrinsics[..., 1, 4] = k1_y * rr * pitch_mm
    H_intrinsics[..., 0, 5] = rr + 2.0 * xx
    H_intrinsics[..., 1, 5] = H_intrinsics[..., 0, 6] = 2.0 * scale * x * y
    H_intrinsics[..., 1, 6] = rr + 2.0 * yy
    return uv, H_rotation, H_intrinsics


def unproject(uv: Array, intrinsics: Array, pitch_mm: float) -> Array:
    """Return the unit directions r_s (..., n, 3) of centroids uv (..., n, 2) [px].

    Inverts the distortion by Newton's method, which converges for any distortion that is a small
    part of the image, as a lens's is.
    """
    u0, v0, f, *lens = (intrinsics[..., k, None] for k in range(7))
    x_m, y_m = (uv[..., 0] - u0) * pitch_mm, (uv[..., 1] - v0) * pitch_mm
    x, y = x_m, y_m
    for _ in range(6):
        x_distorted, y_distorted = _distorted(x, y, *lens)
        e_x, e_y = x_distorted - x_m, y_distorted - y_m
        D_xx, D_xy, D_yy = _distorted_slope(x, y, *lens)
        determinant = D_xx * D_yy - D_xy * D_xy
        x = x - (D_yy * e_x - D_xy * e_y) / determinant
        y = y - (D_xx * e_y - D_xy * e_x) / determinant
    r_s = np.stack(np.broadcast_arrays(-x, -y, f), axis=-1)
    return r_s / np.linalg.norm(r_s, axis=-1, keepdims=True)


def distortion(uv: Array, intrinsics: Array, pitch_mm: float) -> Array:
    """Return the distortion, (..., n, 2) [px], of undistorted image points uv (..., n, 2) [px]."""
    u0, v0, _, *lens = (intrinsics[..., k, None] for k in range(7))
    x, y = (uv[..., 0] - u0) * pitch_mm, (uv[..., 1] - v0) * pitch_mm
    x_distorted, y_distorted = _distorted(x, y, *lens)
    return np.stack((x_distorted - x, y_distorted - y), axis=-1) / pitch_mm
