# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Background and noise of an image: of tiles without their stars, and smooth in between."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, median_filter

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.distributions import normal_cdf, normal_isf, normal_pdf

Image = NDArray[np.float32]

_TILE_PX = 64
_CLIP_SIGMA = 3.0
_ROUNDS = 3
_CLIPPED_VARIANCE = 0.9733      # of a normal distribution cut at 3 sigma
_QUANTISATION = 12.0**-0.5      # steps: the least noise of numbers that have steps
_ROUNDING = float(np.finfo(np.float32).eps)
_TINY = 1e-30
_CUT_PART = 0.05, 0.95           # of a tile's pixels at the least count: the sky is cut off there
_LEAST_PART = 0.05              # of a tile's pixels, that it has a level of its own
_STEEP = 0.75                   # of the noise, from tile to tile: what scatters a twentieth more
_SLOPED = 0.05                  # of a tile's variance that a slope makes; chance makes 0.004


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


def background(image: Image, step: float | None = None) -> Background:
    """Return background and noise of an image (height, width).

    Each tile of about 64 pixels a side gives the mean and the scatter of one in eight of its
    pixels, what lies 3 sigma out left away, three times over; the median of nine tiles then
    ignores one that a bright star fills. Scatter, not the median deviation: the counts of a dark
    image are few and whole. A tile of which next to nothing is known has the values of the
    nearest one. No noise is less than that of the steps of the counts.

    A sky that is cut off, as at 0, scatters less than it would. Where the part p0 of a tile's
    pixels have the least count, and the others are e more than the cut on the mean, a normal
    distribution of the mean m and the standard deviation s has ::

        Phi((cut - m) / s) = p0,    s = e / (phi(z0) / (1 - p0) - z0),   z0 = Phi^-1(p0)   (B.1)

    Parameters
    ----------
    image : (height, width) float32 array
        Counts, NaN where nothing is known; not everywhere.
    step : float, optional
        Between two counts; where it is not stated, 1 of whole numbers, else the least that occurs.
    """
    rows, columns = (max(1, round(size / _TILE_PX)) for size in image.shape)
    height, width = image.shape[0] // rows, image.shape[1] // columns
    tiles = (image[:rows * height, :columns * width].reshape(rows, height, columns, width)
             [:, ::2, :, ::4].transpose(0, 2, 1, 3).reshape(rows * columns, -1))
    unknown = np.isnan(tiles)
    if unknown.all():           # a few pixels between those that are looked at
        tiles = image[~np.isnan(image)][None]
        rows = columns = 1
        unknown = np.isnan(tiles)
    seen = tiles[~unknown]
    step = _step(seen) if step is None else step
    level, noise = _clipped(tiles.astype(float), unknown)
    steep = rows * columns > 1 and _is_steep(*(
        median_filter(value.reshape(rows, columns), 3, mode='nearest')
        for value in (level, noise)))
    if steep:
        level, noise = _clipped(tiles - _slopes(tiles, unknown, height, width), unknown)
    noise = np.maximum(noise, _cut(tiles, float(seen.min()) + step / 2.0))
    part = 1.0 - unknown.mean(axis=1)
    known = part >= min(_LEAST_PART, float(part.max()))
    nearest = distance_transform_edt(~known.reshape(rows, columns), return_distances=False,
                                     return_indices=True)
    level, noise = (value.reshape(rows, columns)[tuple(nearest)] for value in (level, noise))
    if steep:           # so that the median leaves a slope as it is, at the edge, too
        level = median_filter(np.pad(level, 1, 'reflect', reflect_type='odd'), 3)[1:-1, 1:-1]
    else:
        level = median_filter(level, 3, mode='nearest')
    noise = median_filter(noise, 3, mode='nearest')
    if steep:
        noise = np.hypot(noise, _bend(level))
    least = max(_QUANTISATION * step, _ROUNDING * float(np.abs(seen).max()), _TINY)
    return Background(_smooth(level, image.shape, steep),
                      _smooth(np.maximum(noise, least), image.shape))


def _is_steep(level: Array, noise: Array) -> bool:
    """Tell whether levels differ from those of the tiles beside by more than noise explains."""
    return any(bool((np.abs(np.diff(level, axis=axis)) > _STEEP * np.minimum(
        noise.take(range(1, noise.shape[axis]), axis),
        noise.take(range(noise.shape[axis] - 1), axis))).any()) for axis in (0, 1))


def _bend(level: Array) -> Array:
    """Return by how much a level may leave the straight lines between its tiles (rows, columns).

    Of the second difference from tile to tile, a smooth level leaves them by an eighth; one with a
    corner, as at the edge of a cloud or a horizon, by up to a half.
    """
    around = np.pad(level, 1, 'reflect', reflect_type='odd')
    return (np.abs(np.diff(around, 2, axis=0)[:, 1:-1])
            + np.abs(np.diff(around, 2, axis=1)[1:-1])) / 2.0


def _slopes(tiles: Image, unknown: Mask, height: int, width: int) -> Array:
    """Return the plane (n, pixels) of each tile, 0 in its middle; 0 of those that are flat."""
    v, u = (place.ravel() - (size - 1) / 2.0 for place, size in zip(
        np.mgrid[:height:2, :width:4], (height, width)))
    axes = np.stack([u, v], axis=1)
    known = ~unknown
    off = np.where(known, tiles - _median(tiles.astype(float), np.maximum(
        known.sum(axis=1, keepdims=True), 1)), 0.0)
    inside, slope = known, np.zeros((len(tiles), 2))
    for _ in range(2 * _ROUNDS):
        rest = off - slope @ axes.T
        number = np.maximum(inside.sum(axis=1, keepdims=True), 1)
        mean = (rest * inside).sum(axis=1, keepdims=True) / number
        spread = np.sqrt(((rest - mean)**2 * inside).sum(axis=1, keepdims=True) / number)
        inside = known & (np.abs(rest - mean) <= _CLIP_SIGMA * spread)
        slope = slope + ((rest - mean) * inside) @ axes / np.maximum(inside @ axes**2, 1.0)
    plane: Array = slope @ axes.T
    plane[plane.var(axis=1) < _SLOPED * spread[:, 0]**2] = 0.0
    return plane


def _clipped(tiles: Array, unknown: Mask) -> tuple[Array, Array]:
    """Return mean and scatter of each tile (n, pixels), what lies far out left away."""
    known = ~unknown
    number = np.maximum(known.sum(axis=1, keepdims=True), 1)
    middle: Array = (_median(tiles, number) if unknown.any()
                     else np.median(tiles, axis=1, keepdims=True))
    off = np.where(unknown, 0.0, tiles - middle)
    spread = np.sqrt(np.maximum((off**2).sum(axis=1, keepdims=True) / number
                                - (off.sum(axis=1, keepdims=True) / number)**2, 0.0))
    shift: Array = np.zeros_like(middle)
    for _ in range(_ROUNDS):
        inside = known & (np.abs(off - shift) <= _CLIP_SIGMA * spread
                          + _ROUNDING * np.abs(middle))
        number = np.maximum(inside.sum(axis=1, keepdims=True), 1)
        part = off * inside
        shift = part.sum(axis=1, keepdims=True) / number
        # Where all are the same, rounding may leave the difference below zero.
        spread = np.sqrt(np.maximum(np.einsum('ij,ij->i', part, part)[:, None] / number - shift**2,
                                    0.0) / _CLIPPED_VARIANCE)
    return middle + shift, spread


def _cut(tiles: Image, cut: float) -> Array:
    """Return the noise (n, 1) of tiles that are cut off below, Eq. (B.1); 0 of the others."""
    part = np.mean(tiles <= cut, axis=1, keepdims=True)
    is_cut = (part > _CUT_PART[0]) & (part < _CUT_PART[1])
    part = np.clip(part, *_CUT_PART)
    z = -normal_isf(part)
    factor = normal_pdf(z) / normal_cdf(-z) - z
    highest: Array = np.full_like(part, np.inf)
    noise: Array = np.zeros_like(part)
    for _ in range(_ROUNDS):
        over = (tiles > cut) & (tiles <= highest)
        excess = np.where(over, tiles - cut, 0.0).sum(axis=1, keepdims=True) / np.maximum(
            over.sum(axis=1, keepdims=True), 1)
        noise = np.where(is_cut, excess / factor, 0.0)
        highest = cut + _CLIP_SIGMA * noise
    return noise


def _median(tiles: Array, number: Ints) -> Array:
    """Return the median (n, 1) of the first few of the ordered pixels, 0 where there are none."""
    ordered = np.sort(tiles, axis=1)        # NaN last
    low, high = (np.take_along_axis(ordered, at, axis=1) for at in ((number - 1) // 2,
                                                                    number // 2))
    return np.nan_to_num((low + high) / 2.0)


def _step(values: Image) -> float:
    """Return the step of counts: 1 of whole numbers, else the least difference of any two."""
    if np.array_equal(values, np.rint(values)):
        return 1.0
    between = np.diff(np.unique(values))
    return float(between.min()) if len(between) else 0.0


def _smooth(tiles: NDArray[np.floating[Any]], shape: tuple[int, ...], beyond: bool = False
            ) -> Image:
    """Return values of tiles (rows, columns), linear between their centres, for each pixel.

    Beyond the outer ones they go on straight, if so `beyond`, or stay.
    """
    by_row, by_column = (_between(count, size, beyond).astype(np.float32)
                         for count, size in zip(tiles.shape, shape))
    return by_row @ tiles.astype(np.float32) @ by_column.T


def _between(count: int, size: int, beyond: bool) -> Array:
    """Return the weights (size, count) of `count` tiles in each of `size` pixels."""
    centre, pixel = (np.arange(count) + 0.5) * size / count - 0.5, np.arange(size)
    weight = np.stack([np.interp(pixel, centre, unit) for unit in np.eye(count)], axis=1)
    if beyond and count > 1:
        over = (pixel - np.clip(pixel, centre[0], centre[-1])) * count / size
        step = np.clip(over, None, 0.0), np.clip(over, 0.0, None)
        weight[:, :2] += step[0][:, None] * [-1.0, 1.0]
        weight[:, -2:] += step[1][:, None] * [-1.0, 1.0]
    return weight
