# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Angular distances: the camera from the angles between all pairs of stars of a frame.

Model
-----
The angle theta_jk between two stars is the same in the catalogue and behind the right camera. Its
cosine is an element of the Gram matrix of the directions, which is what is compared ::

    cos theta_jk = w_j . w_k,      d cos theta_jk = w_j . d w_k + d w_j . w_k           (A.1)

In units of its own standard deviation the residual of a cosine is, to first order, that of the
angle; but the cosine needs no special case for stars that are close together.

Weighting
---------
The n (n - 1) / 2 angles of a frame are made of 2 n centroids, so their residuals are correlated.

diagonal
    As published: each residual is weighted by its own variance as if it were independent. The
    covariance of the result is then far too small, and the weights are not the best ones.
full
    The covariance of all residuals, J sigma^2 J', with J the slopes by the centroids. Its rank is
    2 n - 3; its pseudo-inverse needs no matrix of that size, as angles determine the directions up
    to a rotation: by Eq. (I.1) of `invariants`, the weighted residuals are P z and P H.

Sources: W19 Sec. 4.1, Test 3 and its references 10 to 17.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.calibration.attitude_free import AttitudeFree
from starcal_ros.calibration.invariants import (Frame, Information, direction_slopes, directions,
                                                information)
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera_estimate import CameraEstimate

MIN_STARS = 2


def start(scenario: Scenario, known: CameraEstimate | None = None) -> AttitudeFree:
    """Begin a calibration with the scenario's ``intrinsics.weighting``."""
    weighting = {'full': full, 'diagonal': diagonal}[scenario.intrinsics.weighting]
    return AttitudeFree(scenario, weighting, MIN_STARS, known)


def cosines(w: Array) -> Array:
    """Return the cosines of the angles between all directions, (..., n, n), of w (..., n, 3)."""
    return w @ np.swapaxes(w, -1, -2)


def slopes(w: Array, dw: Array) -> Array:
    """Return the derivatives of `cosines`, (..., n, n, p), from those of w, (..., n, 3, p)."""
    n, p = dw.shape[-3], dw.shape[-1]
    beside = np.moveaxis(dw, -3, -2).reshape(*dw.shape[:-3], 3, n * p)
    half = (w @ beside).reshape(*dw.shape[:-3], n, n, p)
    return half + np.swapaxes(half, -2, -3)


def variances(w: Array, T: Array) -> Array:
    """Return the variances of `cosines`, (..., n, n), and those of second order.

    With T (..., n, 3, 2) the slopes of w by whitened centroids. The second order matters where two
    stars all but coincide: their cosine is 1 less half the square of what parts them.
    """
    n = w.shape[-2]
    moved = (w @ np.moveaxis(T, -3, -2).reshape(*T.shape[:-3], 3, 2 * n))
    half = np.sum(moved.reshape(*T.shape[:-3], n, n, 2)**2, axis=-1)
    across = 0.5 * np.sum(T * T, axis=(-2, -1))
    return (half + np.swapaxes(half, -1, -2)
            + (across[..., :, None] + across[..., None, :])**2)


def diagonal(frame: Frame) -> Information:
    """Return what all pairs tell, each weighted by its own variance."""
    T = direction_slopes(frame)
    weight = np.triu(1.0 / np.sqrt(variances(frame.r_s, T)), 1)
    z = weight * (cosines(frame.r_s) - cosines(directions(frame, T)))
    H = frame.H.reshape(*frame.N.shape[:-1], -1)
    H = weight[..., None] * slopes(frame.r_s, T @ H)
    return information(z.reshape(*z.shape[:-2], -1), H.reshape(*z.shape[:-2], -1, H.shape[-1]))


def full(frame: Frame) -> Information:
    """Return what all pairs tell, weighted by their whole covariance: Eq. (I.1)."""
    return information(frame.z, frame.H)
