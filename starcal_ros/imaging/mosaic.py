# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Pixels behind a colour filter array (Bayer): the green ones.

A pixel of the one colour lies beside that of another, so that the place of a star measured in all
of them would depend on its colour. The green ones are half of all, on a lattice of their own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from starcal_ros.imaging.lattice import Lattice

PATTERNS = ('RGGB', 'BGGR', 'GRBG', 'GBRG')
"""Colours of the four pixels of a cell, row by row."""
_FALLING, _RISING = ((0, 0), (1, 1)), ((0, 1), (1, 0))      # diagonals of the cell
_SIGMAS = 8.0           # by which levels differ that are not those of one colour
_APART, _ALIKE = 1.0, 0.2       # scatters of a pixel, part of that by which the two green differ
_PIXELS = 20_000        # of each kind that tell its level


def green(counts: NDArray[np.float32], pattern: str) -> Lattice:
    """Return which pixels are green.

    Files contradict each other about the row from which the cells of a pattern count, which turns
    one diagonal into the other. Where the levels of the pixels tell which two are of one colour,
    they decide.

    Parameters
    ----------
    counts : (height, width) float32 array
        Top row first.
    pattern : str
        One of PATTERNS, of the cell at the top left.
    """
    by_falling, by_rising = (abs(off) * np.sqrt(number) for off, number in (
        _over(counts, _FALLING[0], (1, 1)), _over(counts, _RISING[0], (1, -1))))
    is_falling = pattern[0] == 'G'
    if max(by_falling, by_rising) > _SIGMAS + 2.0 * min(by_falling, by_rising):
        is_falling = by_falling < by_rising
    height, width = counts.shape
    return Lattice(height, width, 0 if is_falling else 1)


def pattern_of(counts: NDArray[np.float32]) -> str:
    """Return the pattern of a mosaic of which a file says nothing; empty where it is none.

    The pixels of a diagonal of the cell have one level, those beside them another. Where that is
    so of both diagonals, green is the brighter one; which of the others is red is not told.

    Parameters
    ----------
    counts : (height, width) float32 array
        Top row first, NaN where nothing is known.
    """
    over = [_over(counts, at, by)[0] for at in _FALLING for by in ((0, 1), (1, 0))]
    beside = max(map(abs, over))
    alike = [abs(_over(counts, diagonal[0], by)[0]) < _ALIKE * beside
             for diagonal, by in ((_FALLING, (1, 1)), (_RISING, (1, -1)))]
    if beside < _APART or not any(alike):
        return ''
    return 'GRBG' if alike[0] and (not alike[1] or sum(over) > 0.0) else 'RGGB'


def _over(counts: NDArray[np.float32], at: tuple[int, int], by: tuple[int, int]
          ) -> tuple[float, int]:
    """Return by how much pixels of a kind are over those on either side, and of how many.

    It is in units of the scatter of that difference, in which a slope of the sky is nothing.

    Parameters
    ----------
    counts : (height, width) float32 array
        Top row first, NaN where nothing is known.
    at, by : (int, int)
        Row and column of the pixel in its cell, and from there to one of the two others.
    """
    def moved(down: int, right: int) -> NDArray[np.float32]:
        rows, columns = (slice(2 + start + step, size - 1 + step, 2) for start, step, size in zip(
            at, (down, right), counts.shape))
        part: NDArray[np.float32] = counts[rows, columns].ravel()
        return part[::max(7, part.size // _PIXELS)].astype(float)

    off = moved(0, 0) - (moved(*by) + moved(-by[0], -by[1])) / 2.0
    off = np.sort(off[np.isfinite(off)])
    off = off[len(off) // 50:len(off) - len(off) // 50]         # without most of the stars
    spread = float(np.std(off)) if len(off) else 0.0
    return (float(np.mean(off)) / spread if spread > 0.0 else 0.0), len(off)
