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

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from starcal_ros.config.parameter import Spec
from starcal_ros.config.scenario import Scenario, check_trails
from starcal_ros.core.arrays import Array
from starcal_ros.simulation.star_images import WEIGHTS, ImagedStars

GROUP = 'star_tracker'
ORDER = 40          # before others that move an image: it begins with the trail
ON = {'smear': {'smear': True}}

SPOT_SIGMA_PX = 0.7
"""Sigma s of the spot of a star at rest: 94 % of its light within 3 x 3 pixels."""


@dataclass(frozen=True)
class Config:
    """Whether stars trail."""

    smear: Annotated[bool | None, Spec(
        'Stars trail while the exposure lasts: a centroid is the mean of the moving image, and '
        'its noise grows along the trail (smear); left out, as star_tracker.smear says')] = None


def _on(scenario: Scenario) -> bool:
    smear = scenario.truth.of(Config).smear
    return scenario.star_tracker.smear if smear is None else smear


def check(scenario: Scenario) -> None:
    """Raise ConfigError where the trails are too long."""
    if _on(scenario):
        check_trails('truth.star_tracker.smear', scenario)


def images(scenario: Scenario) -> Callable[[ImagedStars], ImagedStars] | None:
    """Return the function that smears the images of stars, or None where it is off."""
    return _smeared if _on(scenario) else None


def _smeared(images: ImagedStars) -> ImagedStars:
    trail = images.trail()
    return replace(images, uv=centroid(trail), noise_factor=noise_factor(trail))


def centroid(uv: Array) -> Array:
    """Return c, (n, 2), of the places (5, n, 2) at the `instants_ns` [px]."""
    return np.sum(WEIGHTS[:, None, None] * uv, axis=0)


def noise_factor(uv: Array) -> Array:
    """Return G, (n, 2, 2), with G G' = I + S / s^2 of the places (5, n, 2) [px].

    Noise of unit covariance that G multiplies has the shape of the trail.
    """
    off = (uv - centroid(uv)) / SPOT_SIGMA_PX
    S = np.sum(WEIGHTS[:, None, None, None] * off[..., :, None] * off[..., None, :], axis=0)
    return np.linalg.cholesky(np.eye(2) + S)
