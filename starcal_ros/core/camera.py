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
from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Mask

INTRINSICS = ('u0', 'v0', 'f', 'k1', 'k2', 'p1', 'p2')
INTRINSICS_KEYS = ('u0_px', 'v0_px', 'f_mm', 'k1', 'k2', 'p1', 'p2')
"""Their names in files."""
INTRINSICS_SCALE = np.array([0.1, 0.1, 1e-4, 1e-6, 1e-8, 1e-6, 1e-6])
"""What arithmetic divides them by, so that it meets numbers of like size."""

_STEPS = 6              # of Newton's method, at most
_LAST_STEP = 1e-7       # of the focal length
_RAYS = 72              # from the axis outwards, on which the field is searched
_EDGE = 9               # points of each side of the detector that have a ray of their own
_GROWTH = 1.01          # of the angle from one point of a ray to the next,
_FIRST = 0.1            # from this part of the pinhole field on
_WIDEST = np.radians(89.0)


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

    def contains(self, uv: Array) -> Mask:
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
    x, y, *_ = _distorted(-f * r_s[..., 0] / r_s[..., 2], -f * r_s[..., 1] / r_s[..., 2], *lens)
    return np.stack((u0 + x / pitch_mm, v0 + y / pitch_mm), axis=-1)


def _distorted(x: Array, y: Array, k1: Array, k2: Array, p1: Array, p2: Array
               ) -> tuple[Array, Array, Array, Array]:
    """Return the distorted image point [mm], and for `_distorted_slope` the scale s and r^2.

    Eq. 4 in the form ``x + x_d = x s + p1 r^2``, ``s = 1 + k1 r^2 + k2 r^4 + 2 (p1 x + p2 y)``.
    """
    rr = x * x + y * y
    s = 1.0 + rr * (k1 + k2 * rr) + 2.0 * (p1 * x + p2 * y)
    return x * s + p1 * rr, y * s + p2 * rr, s, rr


def _distorted_slope(x: Array, y: Array, s: Array, rr: Array,
                     k1: Array, k2: Array, p1: Array, p2: Array) -> tuple[Array, Array, Array]:
    """Return the derivatives xx, xy = yx, yy of `_distorted` by (x, y)."""
    # d s = (bend x + 2 p1) dx + (bend y + 2 p2) dy
    bend = 2.0 * (k1 + 2.0 * k2 * rr)
    bend_x, bend_y = bend * x, bend * y
    return (s + x * (bend_x + 4.0 * p1), y * (bend_x + 2.0 * p1) + 2.0 * p2 * x,
            s + y * (bend_y + 4.0 * p2))


def _fill_lens_slope(out: Array, x: Array, y: Array, scale: float) -> None:
    """Write scale times the derivative of `_distorted` by k1, k2, p1, p2 into out (..., 2, 4)."""
    xx, yy = scale * x * x, scale * y * y
    rr, r2 = xx + yy, x * x + y * y
    out[..., 0, 0] = k1_x = x * rr
    out[..., 1, 0] = k1_y = y * rr
    out[..., 0, 1] = k1_x * r2
    out[..., 1, 1] = k1_y * r2
    out[..., 0, 2] = rr + 2.0 * xx
    out[..., 1, 2] = out[..., 0, 3] = 2.0 * scale * x * y
    out[..., 1, 3] = rr + 2.0 * yy


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
    x_distorted, y_distorted, s, rr = _distorted(x, y, *lens)
    uv[..., 0], uv[..., 1] = u0 + scale * x_distorted, v0 + scale * y_distorted
    D_xx, D_xy, D_yy = (scale * slope for slope in _distorted_slope(x, y, s, rr, *lens))

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
    _fill_lens_slope(H_intrinsics[..., 3:], x, y, scale)
    return uv, H_rotation, H_intrinsics


def unproject(uv: Array, intrinsics: Array, pitch_mm: float, steps: int = _STEPS) -> Array:
    """Return the unit directions r_s (..., n, 3) of centroids uv (..., n, 2) [px].

    Inverts the distortion by Newton's method, which converges for any distortion that is a small
    part of the image, as a lens's is. Two steps are exact to rounding; none is good to 1e-5 where
    the distortion is 2 % of the image.
    """
    x, y, f = _undistorted(uv, intrinsics, pitch_mm, steps)
    return _ray(x, y, f)[0]


def _ray(x: Array, y: Array, f: Array) -> tuple[Array, Array]:
    """Return the unit directions (..., 3) of undistorted points, and 1 / |(-x, -y, f)|."""
    inverse = 1.0 / np.sqrt(x * x + y * y + f * f)
    r_s = np.empty((*x.shape, 3))
    r_s[..., 0], r_s[..., 1], r_s[..., 2] = -x * inverse, -y * inverse, f * inverse
    return r_s, inverse


def _undistorted(uv: Array, intrinsics: Array, pitch_mm: float, steps: int = _STEPS
                 ) -> tuple[Array, Array, Array]:
    """Return the undistorted image point x, y (..., n) and f (..., 1) [mm]."""
    u0, v0, f, *lens = (intrinsics[..., k, None] for k in range(7))
    x_m, y_m = (uv[..., 0] - u0) * pitch_mm, (uv[..., 1] - v0) * pitch_mm
    x, y = x_m, y_m
    for _ in range(2):                  # cheaper than a Newton step, and half as good
        x_distorted, y_distorted, *_ = _distorted(x, y, *lens)
        x, y = x + (x_m - x_distorted), y + (y_m - y_distorted)
    for _ in range(steps):
        x_distorted, y_distorted, s, rr = _distorted(x, y, *lens)
        e_x, e_y = x_distorted - x_m, y_distorted - y_m
        D_xx, D_xy, D_yy = _distorted_slope(x, y, s, rr, *lens)
        inverse = 1.0 / (D_xx * D_yy - D_xy * D_xy)
        step_x, step_y = (D_yy * e_x - D_xy * e_y) * inverse, (D_xx * e_y - D_xy * e_x) * inverse
        x, y = x - step_x, y - step_y
        # The error squares with each step: after one this small it is below rounding.
        if max(np.abs(step_x).max(initial=0.0), np.abs(step_y).max(initial=0.0)) <= (
                _LAST_STEP * f.min()):
            break
    return x, y, f


def backproject(uv: Array, intrinsics: Array, pitch_mm: float) -> tuple[Array, Array, Array]:
    """Return the unit directions of centroids, as `unproject`, and their derivatives.

    The undistorted point (x, y) is where `_distorted` is the measured one, m = (uv - uv0) d. By
    the implicit function theorem, with the slope D of the distortion there ::

        d(x, y)/d m = D^-1,     d(x, y)/d lens = -D^-1 d(x_d, y_d)/d lens

    Parameters
    ----------
    uv : (..., n, 2) array
        Centroids [px].
    intrinsics, pitch_mm
        As for `project`.

    Returns
    -------
    w_s : (..., n, 3) array
        Unit directions in s.
    dw_duv : (..., n, 3, 2) array
        d w_s / d uv at a fixed camera [1/px].
    dw_dintrinsics : (..., n, 3, 7) array
        d w_s / d intrinsics at fixed centroids.
    """
    x, y, f = _undistorted(uv, intrinsics, pitch_mm)
    lens = [intrinsics[..., k, None] for k in range(3, 7)]
    _, _, s, rr = _distorted(x, y, *lens)
    D_xx, D_xy, D_yy = _distorted_slope(x, y, s, rr, *lens)
    inverse = np.empty((*x.shape, 2, 2))
    determinant = D_xx * D_yy - D_xy * D_xy
    inverse[..., 0, 0], inverse[..., 1, 1] = D_yy / determinant, D_xx / determinant
    inverse[..., 0, 1] = inverse[..., 1, 0] = -D_xy / determinant

    # q = (-x, -y, f), w = q / |q|, dw = (I - w w') dq / |q|.
    w_s, shrink = _ray(x, y, f)
    across = (np.eye(3) - w_s[..., :, None] * w_s[..., None, :]) * shrink[..., None, None]
    dw_duv = -pitch_mm * across[..., :2] @ inverse
    lens_slope = np.empty((*x.shape, 2, 4))
    _fill_lens_slope(lens_slope, x, y, 1.0 / pitch_mm)
    return w_s, dw_duv, np.concatenate(
        (-dw_duv, across[..., 2:], -dw_duv @ lens_slope), axis=-1)


def distortion(uv: Array, intrinsics: Array, pitch_mm: float) -> Array:
    """Return the distortion, (..., n, 2) [px], of undistorted image points uv (..., n, 2) [px]."""
    u0, v0, _, *lens = (intrinsics[..., k, None] for k in range(7))
    x, y = (uv[..., 0] - u0) * pitch_mm, (uv[..., 1] - v0) * pitch_mm
    x_distorted, y_distorted, *_ = _distorted(x, y, *lens)
    return np.stack((x_distorted - x, y_distorted - y), axis=-1) / pitch_mm


class FieldOfView(NamedTuple):
    """What part of the sky a camera sees.

    Attributes
    ----------
    radius : float
        Largest angle from the boresight, 89 deg at most [rad].
    whole : bool
        False where the distortion folds back, or 89 deg are reached, before the edge of the
        detector: what lies further off sees nothing.
    """

    radius: float
    whole: bool


def unfolded(r_s: Array, intrinsics: Array) -> Mask:
    """Tell for which directions (..., n, 3) the distortion keeps the image's handedness.

    Where it does not, the polynomial has turned back: it puts stars from far outside the field
    onto the detector, which no lens does.
    """
    _, _, f, *lens = (intrinsics[..., k, None] for k in range(7))
    x, y = -f * r_s[..., 0] / r_s[..., 2], -f * r_s[..., 1] / r_s[..., 2]
    _, _, s, rr = _distorted(x, y, *lens)
    D_xx, D_xy, D_yy = _distorted_slope(x, y, s, rr, *lens)
    return (D_xx * D_yy > D_xy * D_xy) & (D_xx + D_yy > 0.0)


def field_of_view(detector: Detector, intrinsics: Array, margin: float = 1.0) -> FieldOfView:
    """Return the field of a camera with intrinsics (7,), to a hundredth of its radius.

    It is searched outwards from the axis up to where the distortion folds back, through the lens
    as it is: how strong that is does not matter.

    Parameters
    ----------
    detector : Detector
        Its pixels.
    intrinsics : (7,) array
        Camera.
    margin : float
        By which the detector is taken larger than it is, for `radius` alone.
    """
    size = np.array([detector.width, detector.height])
    side = np.linspace(-0.5, 0.5, _EDGE)
    edge = size * np.concatenate([
        np.stack(np.broadcast_arrays(*at), axis=-1)
        for at in ((side, -0.5), (side, 0.5), (-0.5, side), (0.5, side))]) - intrinsics[:2]
    way = np.concatenate((np.arctan2(edge[:, 1], edge[:, 0]),
                          np.linspace(0.0, 2.0 * np.pi, _RAYS, endpoint=False)))
    pinhole = np.arctan(detector.pitch_mm * np.hypot(*edge.T).max() / intrinsics[2])
    count = int(np.ceil(np.log(_WIDEST / (_FIRST * pinhole)) / np.log(_GROWTH)))
    angle = np.append(0.0, np.minimum(_FIRST * pinhole * _GROWTH**np.arange(count + 1), _WIDEST))
    r_s = np.empty((len(way), len(angle), 3))
    r_s[..., 0], r_s[..., 1] = (-np.sin(angle) * part[:, None]
                                for part in (np.cos(way), np.sin(way)))
    r_s[..., 2] = np.cos(angle)
    reached = np.logical_and.accumulate(unfolded(r_s, intrinsics), axis=1)
    uv = project(r_s, intrinsics, detector.pitch_mm)
    seen = reached & detector.contains(uv / margin)
    ends = reached.sum(axis=1) - 1
    whole = not detector.contains(uv[np.arange(len(way)), ends]).any()
    return FieldOfView(float(min(_GROWTH * angle[seen.any(axis=0)].max(initial=0.0), _WIDEST)),
                       whole)
