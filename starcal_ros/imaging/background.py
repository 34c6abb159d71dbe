# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Background and noise of an image: of tiles without their stars, and smooth in between."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from starcal_ros.core.arrays import Array

Image = NDArray[np.float32]

_TILE_PX = 64
_CLIP_SIGMA = 3.0
_ROUNDS = 3
_CLIPPED_VARIANCE = 0.9733      # of a normal distribution cut at 3 sigma
_QUANTISATION = 12.0**-0.5      # counts: the least noise of whole numbers


class Background(NamedTuple):
    """Background and noise.

    Attributes
    ----------
    level : (height, width) float32 array
        Background of each pixel [counts].
    noise : (height, width) float32 array
        Standard deviation of a pixel without stars [counts].
    """

    level: Image
    noise: Image


def background(image: Image) -> Background:
    """Return background and noise of an image (height, width).

    Each tile of about 64 pixels a side gives the mean and the scatter of one in eight of its
    pixels, what lies 3 sigma out left away, three times over; the median of nine tiles then
    ignores one that a bright star fills. Scatter, not the median deviation: the counts of a dark
    image are few and whole.
    """
    rows, columns = (max(1, round(size / _TILE_PX)) for size in image.shape)
    height, width = image.shape[0] // rows, image.shape[1] // columns
    tiles = (image[:rows * height, :columns * width].reshape(rows, height, columns, width)
             [:, ::2, :, ::4].transpose(0, 2, 1, 3).reshape(rows * columns, -1))
    middle: NDArray[np.floating[Any]] = np.median(tiles, axis=1, keepdims=True)
    spread = tiles.std(axis=1, keepdims=True)
    for _ in range(_ROUNDS):
        off = tiles - middle
        inside = np.abs(off) <= _CLIP_SIGMA * spread
        off *= inside
        number = inside.sum(axis=1, keepdims=True)
        shift = off.sum(axis=1, keepdims=True) / number
        spread = np.sqrt((np.einsum('ij,ij->i', off, off)[:, None] / number - shift**2)
                         / _CLIPPED_VARIANCE)
        middle = middle + shift
    level, noise = (median_filter(value.reshape(rows, columns), 3, mode='nearest')
                    for value in (middle, spread))
    return Background(_smooth(level, image.shape),
                      _smooth(np.maximum(noise, _QUANTISATION), image.shape))


def _smooth(tiles: NDArray[np.floating[Any]], shape: tuple[int, ...]) -> Image:
    """Return values of tiles (rows, columns), linear between their centres, for each pixel."""
    by_row, by_column = (
        _between(count, size).astype(np.float32) for count, size in zip(tiles.shape, shape))
    return by_row @ tiles.astype(np.float32) @ by_column.T


def _between(count: int, size: int) -> Array:
    """Return the weights (size, count) of `count` tiles in each of `size` pixels."""
    centre = (np.arange(count) + 0.5) * size / count - 0.5
    return np.stack([np.interp(np.arange(size), centre, unit) for unit in np.eye(count)], axis=1)
