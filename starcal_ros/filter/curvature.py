# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the linear model of a frame leaves out, and how far a frame may be believed for it.

To second order a predicted centroid h errs, by an error ``x = L xi`` of attitude and camera, by ::

    h(x) - h(0) = H L xi + 1/2 xi' L' h'' L xi,     xi ~ N(0, I)
    variance of the second term = 1/2 sum_ij (L' h'' L)_ij^2                           (U.1)

with ``h'' L_j = H(L_j) - H(0)`` from differences of the Jacobian H. (The truncated second-order
filter adds this to the noise of the measurement: Athans, Wishner and Bertolini 1968.)

It matters while camera and attitude are wide: at a field of 2 deg an unknown distortion moves the
stars by 30 px, and what a shift of the principal point looks like depends on it. The first frames
are then believed along directions that later ones contradict, and sigmas end below the errors.

As noise this term would average out over the frames. It does not: the same error leaves the same
term out of each, until it is known. So it counts `REPEATS` times, as of so many frames that share
it: together they do not say more than their common part. Where it does not matter any more, not a
bit differs.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core import camera, rotation
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.camera import Detector

REPEATS = 1000.0
"""Number of frames, 500 s at 2 Hz, that may share what the model leaves out."""

MATTERS = 0.1
"""Part of the sigma of a centroid up to which the term is left out."""

BETWEEN = 2.0
"""By how much the term of a star may exceed that of a direction near it, and of a camera."""

_STEP = 1e-3            # of the differences, relative to SCALE below
_SCALE = np.array([*(1e-2,) * 3, *(1e3 * camera.INTRINSICS_SCALE)])
_RAYS = 8


def _fitting(root: Array, sigma_px: Array, shift: Array, px: Array) -> Array:
    """Return the root of the errors that are not seen, (..., 10, k).

    The attitude is one that fits the stars: it errs by what the camera moves them.
    """
    spread = np.linalg.norm(root, axis=-1)
    finest = sigma_px.min(axis=-1, initial=np.inf)
    moved = np.sum(shift * spread[..., 3:], axis=-1) + np.where(
        np.isfinite(finest), finest, 0.0)
    part = np.minimum(1.0, (moved * px)[..., None] / np.maximum(spread[..., :3], 1e-300))
    return np.concatenate((part[..., None] * root[..., :3, :], root[..., 3:, :]), axis=-2)


def bends(root: Array, sigma_px: Array, shift: Array, second: Array, largest: Array, px: Array
          ) -> Mask:
    """Tell where what a frame leaves out may matter, (...).

    It does not where a bound by the standard deviations alone is small, nor where the term is in
    all parts of the field, what is known of the errors together considered.

    Parameters
    ----------
    root : (..., 10, k) array
        Root of the covariance of turn [rad] and intrinsics.
    sigma_px : (..., n) array
        Of the centroids; infinite for what is not used.
    shift, second, largest : arrays
        See `Curvature`.
    px : (...) array
        Angle of a pixel at the centre [rad].
    """
    root = _fitting(root, sigma_px, shift, px)
    spread = np.linalg.norm(root, axis=-1)
    bound = np.einsum('...i,ij,...j->...', spread, largest, spread)
    matters = MATTERS * sigma_px.min(axis=-1, initial=np.inf)
    scale = np.sqrt(REPEATS / 2.0)
    may = np.asarray(scale * bound > matters)
    if not may.any():
        return may
    P = (root @ np.swapaxes(root, -1, -2))[..., None, :, :]
    term = np.sum((second @ P) * (P @ second), axis=(-2, -1)).max(axis=-1)
    return may & (BETWEEN * scale * np.sqrt(np.maximum(term, 0.0)) > matters)


class Curvature:
    """The second derivatives of the centroids of one camera, by its turn and its intrinsics.

    The ten errors are the turn theta of ``r_s -> (I + [theta x]) r_s`` and the intrinsics.

    Parameters
    ----------
    detector : Detector
    intrinsics : (7,) array
        Nominal camera.

    Attributes
    ----------
    second : (r, 10, 10) array
        Second derivatives of both coordinates, in some directions over the field.
    largest : (10, 10) array
        Bound of them.
    shift : (7,) array
        Bound of the derivatives by the intrinsics.
    """

    def __init__(self, detector: Detector, intrinsics: Array) -> None:
        self._pitch_mm = detector.pitch_mm
        radius = camera.field_of_view(detector, intrinsics).radius * np.array([[0.5], [1.0]])
        way = np.linspace(0.0, 2.0 * np.pi, _RAYS, endpoint=False)
        r_s = np.stack(np.broadcast_arrays(np.sin(radius) * np.cos(way), np.sin(radius)
                                           * np.sin(way), np.cos(radius)), axis=-1).reshape(-1, 3)
        H = self._jacobian(r_s, intrinsics)
        bent = self._bent(r_s, intrinsics, H, np.diag(_STEP * _SCALE)) / (_STEP * _SCALE)[
            :, None, None, None]
        self.second = np.ascontiguousarray(np.moveaxis(bent, 0, -1).reshape(-1, 10, 10))
        self.largest = np.abs(self.second).max(axis=0)
        self.shift = np.abs(H[..., 3:]).max(axis=(0, 1))                       # (7,)

    def left_out(self, r_s: Array, intrinsics: Array, root: Array, sigma_px: Array) -> Array:
        """Return the standard deviation of what a frame repeats of Eq. (U.1).

        Parameters
        ----------
        r_s : (..., n, 3) array
            Predicted directions of its stars.
        intrinsics : (..., 7) array
            Camera.
        root : (..., 10, k) array
            Root of the covariance of turn [rad] and intrinsics.
        sigma_px : (..., n) array
            Of the centroids; infinite for what is not used.

        Returns
        -------
        sigma_px : (..., n) array
            The larger of both coordinates [px]; exactly zero where it does not matter.
        """
        root = _fitting(root, sigma_px, self.shift, self._pitch_mm / intrinsics[..., 2])
        root = np.swapaxes(np.linalg.qr(np.swapaxes(root, -1, -2), mode='r'), -1, -2)
        bent = self._bent(r_s, intrinsics, self._jacobian(r_s, intrinsics),
                          np.swapaxes(root, -1, -2)) @ root[..., None, None, :, :]
        variance = 0.5 * REPEATS * np.sum(bent * bent, axis=(-4, -1)).max(axis=-1)
        return np.where(variance > (MATTERS * sigma_px)**2, np.sqrt(variance), 0.0)

    def _jacobian(self, r_s: Array, intrinsics: Array) -> Array:
        _, H_s, H_lens = camera.linearize(r_s, intrinsics, self._pitch_mm)
        return np.concatenate((H_s, H_lens), axis=-1)

    def _bent(self, r_s: Array, intrinsics: Array, H: Array, errors: Array) -> Array:
        """Return how errors (..., k, 10) change the Jacobian H, (..., k, n, 2, 10)."""
        turned = r_s[..., None, :, :] @ np.swapaxes(rotation.exp(errors[..., :3]), -1, -2)
        return self._jacobian(turned, intrinsics[..., None, :] + errors[..., 3:]) - H[
            ..., None, :, :, :]
