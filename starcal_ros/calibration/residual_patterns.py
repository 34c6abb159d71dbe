# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Patterns that residuals show where the model of the camera lacks something.

A pattern is a set of directions D, (n, 2, k), for n stars: k effects, each by what it does to the
two coordinates of every star. They are what a lens may do beyond its model, a shift of each part
of the detector, a wave over the pixel, and an error of the camera in each run of frames.
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.camera import Detector

GROUPS = 12
"""Runs of frames, each with a camera of its own, that are compared, at most."""
_A_CELL = 20            # stars of a cell, on average, at least


def lens_terms(xy: Array, detector: Detector) -> Array:
    """Return what a lens may do beyond the model, (n, 2, 10), at points xy (n, 2).

    Radial terms of the seventh and ninth order, decentring of the fourth, a prism of the second
    and of the fourth order, and a scale and an axis that differ between u and v.
    """
    x, y = (xy / (0.5 * np.hypot(detector.width, detector.height))).T
    rr, nought = x * x + y * y, np.zeros(len(x))
    terms = [(x * rr**3, y * rr**3), (x * rr**4, y * rr**4),
             (rr * (rr + 2.0 * x * x), 2.0 * rr * x * y),
             (2.0 * rr * x * y, rr * (rr + 2.0 * y * y)),
             (rr, nought), (nought, rr), (rr * rr, nought), (nought, rr * rr),
             (x, -y), (y, x)]
    return np.moveaxis(np.array(terms), -1, 0).swapaxes(1, 2)


def phase_terms(uv_raster: Array) -> Array:
    """Return two harmonics of the place within a pixel, each axis its own, (n, 2, 8)."""
    out = np.zeros((len(uv_raster), 2, 8))
    for axis in range(2):
        angle = 2.0 * np.pi * uv_raster[:, axis]
        out[:, axis, 4 * axis:4 * axis + 4] = np.stack(
            (np.sin(angle), np.cos(angle), np.sin(2.0 * angle), np.cos(2.0 * angle)), axis=-1)
    return out


def cell(uv: Array, detector: Detector, most: int) -> Ints:
    """Return the cell of each star, as many along each side as stars suffice for."""
    side = int(np.clip(np.sqrt(len(uv) / _A_CELL), 2, most))
    place = np.floor((uv / [detector.width, detector.height] + 0.5) * side)
    column, row = np.clip(place, 0, side - 1).astype(np.int64).T
    return np.asarray(row * side + column)


def quantile(values: Array, parts: int) -> Ints:
    """Return in which of so many parts of like size each value is."""
    edges = np.quantile(values, np.linspace(0.0, 1.0, parts + 1)[1:-1])
    return np.asarray(np.searchsorted(edges, values), np.int64)


def weightiest(sigma: Array, share: float) -> Mask:
    """Tell which stars of the least sigmas have a share of the weight 1 / sigma^2 of all.

    All, where the sigmas are alike.
    """
    ordered = np.sort(sigma)
    weight = np.cumsum(1.0 / ordered**2)
    return np.asarray(sigma <= ordered[np.searchsorted(weight, share * weight[-1])])


def of_groups(group: Ints) -> Array:
    """Return a shift of each group along u and along v, (n, 2, k)."""
    member = np.eye(int(group.max()) + 1)[group]
    return np.concatenate([np.stack((member, nought), axis=1)[:, ::step]
                           for nought in [np.zeros_like(member)] for step in (1, -1)], axis=-1)


def of_runs(frame: Ints, by_camera: Array) -> Array:
    """Return an error of the camera in each run of frames, (n, 2, k)."""
    number = np.unique(frame, return_inverse=True)[1]
    frames = int(number.max()) + 1
    runs = min(frames, GROUPS)
    member = np.eye(runs)[number * runs // frames]
    return (by_camera[..., None] * member[:, None, None, :]).reshape(len(frame), 2, -1)
