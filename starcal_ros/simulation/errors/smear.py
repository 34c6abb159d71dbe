# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Smear: stars trail over the detector while the exposure lasts.

Model
-----
A photon lands on the spot of its star, a Gaussian of sigma s, where the image is at its moment of
the exposure T. A centroid is the mean of N photons, so its mean and covariance are ::

    c = 1/T integral of uv(t) dt
    P = (s^2 I + S) / N = sigma^2 (I + S / s^2)                                (S.1)
    S = 1/T integral of (uv(t) - c) (uv(t) - c)' dt

    sigma    px    standard deviation of a centroid at rest, s / sqrt(N)

A star that moves steadily over L pixels has S = L^2/12 along its trail: at 0.5 deg/s and 180 ms,
T18's camera sees L = 6 px, and the noise along the trail grows 2.8 times. Across it stays as it
is; noise of the background and of the readout, which would grow there too, is left out.

The integrals are Gauss-Lobatto sums of five points; c is exact for an image that moves as a
polynomial in time up to the seventh power. Where a slew begins or ends within the exposure it is
good to 4e-4 a T^2, a the step of the image's acceleration: 5e-4 px for T18's.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array

SPOT_SIGMA_PX = 0.7
"""Sigma s of the spot of a star at rest: 94 % of its light within 3 x 3 pixels."""

_NODES = np.array([-1.0, -np.sqrt(3.0 / 7.0), 0.0, np.sqrt(3.0 / 7.0), 1.0]) / 2.0
_WEIGHTS = np.array([9.0, 49.0, 64.0, 49.0, 9.0]) / 180.0


def instants_ns(exposure_s: float) -> list[int]:
    """Return when to look, from the middle of the exposure [ns]."""
    return np.rint(_NODES * exposure_s * 1e9).astype(int).tolist()


def centroid(uv: Array) -> Array:
    """Return c, (n, 2), of the places (5, n, 2) at the `instants_ns` [px]."""
    return np.sum(_WEIGHTS[:, None, None] * uv, axis=0)


def noise_factor(uv: Array) -> Array:
    """Return G, (n, 2, 2), with G G' = I + S / s^2 of the places (5, n, 2) [px].

    Noise of unit covariance that G multiplies has the shape of the trail.
    """
    off = (uv - centroid(uv)) / SPOT_SIGMA_PX
    S = np.sum(_WEIGHTS[:, None, None, None] * off[..., :, None] * off[..., None, :], axis=0)
    return np.linalg.cholesky(np.eye(2) + S)
