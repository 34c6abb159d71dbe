# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Detections in an image: connected pixels that rise over the noise, roughly measured.

The image is smoothed with (1, 2, 1) / 4 along both axes, nearly what fits a spot of s = 0.7 px
best. Where it exceeds the threshold, pixels that touch make a spot; what is less than half of a
spot's peak is then left away, which parts stars that touch. One pixel alone, with less than a
quarter of its light in the four beside it together, is a hot pixel or a cosmic ray: the spot of a
star with s of 0.33 px or more never is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from starcal_ros.core.arrays import Array, Ints, Mask

Image = NDArray[np.float32]
Rows = Ints

_SMOOTHED_NOISE = 6.0 / 16.0    # of white noise, after _smoothed
_PART_OF_PEAK = np.float32(0.5)
_SHARP = 0.25
_LEAST_LIGHT = 1e-3             # of the noise: a pixel counts to its spot


class Detections(NamedTuple):
    """Connected pixels, brightest first.

    Attributes
    ----------
    uv_raster : (n, 2) array
        Centre of their light [px].
    moments : (n, 2, 2) array
        Second moments of their light [px^2].
    flux : (n,) array
        Their light [counts].
    significance : (n,) array
        It over the noise of as many pixels.
    """

    uv_raster: Array
    moments: Array
    flux: Array
    significance: Array

    def take(self, rows: Rows) -> Detections:
        """Return some of the spots."""
        return Detections(*(value[rows] for value in self))


def find_spots(image: Image, noise: Image, threshold: float) -> Detections:
    """Return the spots of an image less its background.

    Parameters
    ----------
    image, noise : (height, width) float32 array
        Counts over the background, and their standard deviation, in units of a typical one.
    threshold : float
        Least value of the smoothed image, in standard deviations of its noise.
    """
    width = image.shape[1]
    smooth = _smoothed(image).ravel()
    pixel = np.flatnonzero(smooth > np.float32(threshold * _SMOOTHED_NOISE) * noise.ravel())
    of, count = _connected(pixel, width)
    peak = np.zeros(count, np.float32)
    np.maximum.at(peak, of, smooth[pixel])
    pixel = pixel[smooth[pixel] > _PART_OF_PEAK * peak[of]]
    of, count = _connected(pixel, width)

    place = np.stack(np.divmod(pixel, width)[::-1], axis=-1).astype(float)
    light = np.maximum(image.ravel()[pixel], _LEAST_LIGHT).astype(float)

    def total(value: Array) -> Array:
        return np.asarray(np.bincount(of, value, count), float)

    flux = total(light)

    uv = np.stack([total(light * axis) / flux for axis in place.T], axis=-1)
    off = place - uv[of]
    moments = np.stack([total(light * off[:, i] * off[:, j]) / flux
                        for i in (0, 1) for j in (0, 1)], axis=-1)
    variance = total(noise.ravel()[pixel].astype(float)**2)

    keep = ~_sharp(image.ravel(), width, pixel, of, light)
    order = np.flatnonzero(keep)[np.argsort(-flux[keep], kind='stable')]
    return Detections(uv[order], moments.reshape(-1, 2, 2)[order], flux[order],
                      (flux / np.sqrt(variance))[order])


def _connected(pixel: Rows, width: int) -> tuple[Rows, int]:
    """Return the group of each pixel, all that touch, and the number of groups.

    The pixels are sorted indices into an image whose border has none of them.
    """
    pairs = []
    for step in (1, width - 1, width, width + 1):
        at = np.minimum(np.searchsorted(pixel, pixel + step), max(len(pixel) - 1, 0))
        touching = np.flatnonzero(pixel[at] == pixel + step)
        pairs.append((touching, at[touching]))
    one, other = (np.concatenate(part) for part in zip(*pairs))
    graph = coo_array((np.ones(len(one), bool), (one, other)), (len(pixel), len(pixel)))
    count, of = connected_components(graph, directed=False)
    return of.astype(np.int64), int(count)


def _smoothed(image: Image) -> Image:
    """Return the image smoothed along both axes, 0 at its border."""
    rows = 2.0 * image[1:-1]
    rows += image[:-2]
    rows += image[2:]
    smooth = np.zeros_like(image)
    inner = smooth[1:-1, 1:-1]
    inner += rows[:, 1:-1]
    inner *= 2.0
    inner += rows[:, :-2]
    inner += rows[:, 2:]
    inner /= 16.0
    return smooth


def _sharp(image: Image, width: int, pixel: Rows, of: Rows, light: Array) -> Mask:
    """Tell which spots are a pixel alone, of a flat image."""
    order = np.lexsort((-light, of))
    brightest = order[np.searchsorted(of[order], np.arange(of.max(initial=-1) + 1))]
    beside = np.stack([image[pixel[brightest] + step] for step in (-1, 1, -width, width)])
    return np.asarray(beside.sum(axis=0) < _SHARP * light[brightest])
