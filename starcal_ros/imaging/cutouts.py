# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the spots of a frame look like, and square cuttings of the frame about them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.imaging.light import Light

Rows = Ints

_LEAST_SIGMA, _LONGEST_TRAIL, _LARGEST_HALF = 0.3, 60.0, 32     # px
_ROUND = 0.15                   # second moments along and across differ less: no trail


class Shape(NamedTuple):
    """What the spots of a frame look like: sigma of a spot at rest, and its trail (2,) [px]."""

    sigma: float
    trail: Array

    @classmethod
    def of_moments(cls, moments: Array) -> Shape:
        """Return the shape with second moments (2, 2) of its light [px^2]."""
        trail = trail_of(moments)
        across = float(np.linalg.eigvalsh(moments)[0])
        return cls.bounded(across if trail.any() else float(np.trace(moments)) / 2.0, trail)

    @classmethod
    def bounded(cls, variance: float, trail: Array) -> Shape:
        """Return a shape of a variance [px^2] and a trail, brought into what can be fitted."""
        length = float(np.linalg.norm(trail))
        return cls(float(np.sqrt(max(variance, _LEAST_SIGMA**2))),
                   trail * min(1.0, _LONGEST_TRAIL / max(length, 1.0)))

    @property
    def moments(self) -> Array:
        """Second moments (2, 2) of the light [px^2]."""
        return self.sigma**2 * np.eye(2) + np.outer(self.trail, self.trail) / 12.0

    @property
    def half(self) -> int:
        """Pixels on each side of the middle one that hold nearly all of the light."""
        half = np.ceil(2.5 * self.sigma + np.abs(self.trail).max() / 2.0 + 0.5)
        return int(min(half, _LARGEST_HALF))


def trail_of(moments: Array) -> Array:
    """Return the trail (2,) of second moments (2, 2), 0 where they are round [px]."""
    (across, along), axes = np.linalg.eigh(moments)
    if along < (1.0 + _ROUND) * across:
        return np.zeros(2)
    return np.asarray(np.sqrt(12.0 * (along - across)) * axes[:, 1])


class Cutouts(NamedTuple):
    """Square cutouts of an image about n spots.

    Attributes
    ----------
    middle : (n, 2) int64 array
        Column and row of the middle pixel.
    counts : (n, k, k) array
        Counts over the background, rows first.
    valid : (n, k, k) bool array
        Pixels of the image that are known and not saturated.
    noise : (n,) array
        Standard deviation of a pixel without stars [counts].
    saturated, cut : (n,) bool array
        Cutouts with a saturated pixel, and those that reach out of the image or into pixels of
        which nothing is known.
    """

    middle: Rows
    counts: Array
    valid: Mask
    noise: Array
    saturated: Mask
    cut: Mask

    @classmethod
    def of(cls, light: Light, uv_raster: Array, half: int) -> Cutouts:
        """Cut an image about some places, `half` pixels on each side of the nearest one."""
        middle = np.rint(uv_raster).astype(np.int64)
        reach = np.arange(-half, half + 1)
        u, v = middle[:, 0, None] + reach, middle[:, 1, None] + reach
        height, width = light.counts.shape
        inside = ((v >= 0) & (v < height))[:, :, None] & ((u >= 0) & (u < width))[:, None, :]
        at = np.clip(v, 0, height - 1)[:, :, None], np.clip(u, 0, width - 1)[:, None, :]
        full = light.saturated[at] & inside
        inside &= ~light.unknown[at]
        return cls(middle, light.counts[at].astype(float), inside & ~full,
                   light.noise[middle[:, 1], middle[:, 0]].astype(float), full.any(axis=(1, 2)),
                   np.asarray((~inside).any(axis=(1, 2))))

    def take(self, rows: Rows) -> Cutouts:
        """Return some of the cutouts."""
        return Cutouts(self.middle[rows], self.counts[rows], self.valid[rows], self.noise[rows],
                       self.saturated[rows], self.cut[rows])
