# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The best spots of each part of an image: a crowd in one corner does not hide the stars."""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array, Ints

_CELLS = 8              # along the longer side


def rank_in_cell(uv_raster: Array, flux: Array, shape: tuple[int, int]) -> tuple[Ints, Ints]:
    """Return how many spots of its cell are brighter than each, and the spots of each cell.

    Parameters
    ----------
    uv_raster : (n, 2) array
        Places [px].
    flux : (n,) array
        Of the spots, in any unit.
    shape : (int, int)
        Height and width of the image [px].

    Returns
    -------
    rank : (n,) int64 array
    counts : (cells,) int64 array
    """
    size = max(shape) / _CELLS
    columns, rows = (max(1, round(side / size)) for side in (shape[1], shape[0]))
    at = np.floor(uv_raster / [shape[1], shape[0]] * [columns, rows]).astype(np.int64)
    column, row = np.clip(at, 0, [columns - 1, rows - 1]).T
    cell = row * columns + column
    order = np.lexsort((-flux, cell))
    counts = np.bincount(cell, minlength=rows * columns)
    first = np.cumsum(counts) - counts
    rank = np.empty(len(cell), np.int64)
    rank[order] = np.arange(len(cell)) - first[cell[order]]
    return rank, counts


def best(uv_raster: Array, flux: Array, shape: tuple[int, int], count: int) -> Ints:
    """Return the rows of the `count` brightest spots, brightest first, but of no cell a crowd.

    A cell gives no more than twice as many as half of the cells have, nor need it give fewer than
    its share.
    """
    rank, counts = rank_in_cell(uv_raster, flux, shape)
    quota = max(2 * int(np.median(counts)), -(-count // len(counts)))
    order = np.argsort(-flux, kind='stable')
    return order[rank[order] < quota][:count]


def clear_of_crowds(uv_raster: Array, significance: Array, shape: tuple[int, int]) -> Ints:
    """Return the rows of the most significant spot of each cell."""
    rank, _ = rank_in_cell(uv_raster, significance, shape)
    return np.flatnonzero(rank == 0)
