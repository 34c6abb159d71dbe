# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Pixels behind a colour filter array (Bayer): the green ones, as an image of half the size.

A pixel of the one colour lies beside that of another, so that the place of a star measured in all
of them would depend on its colour. The two green ones of a cell lie on either side of its middle:
their mean has no such error, keeps the noise of its pixels apart, and is half of the light.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PATTERNS = ('RGGB', 'BGGR', 'GRBG', 'GBRG')
"""Colours of the four pixels of a cell, row by row."""
SPACING = 2
"""Pixels of the camera from one of the green image to the next."""

_SIGMAS = 8.0           # by which levels differ that are not those of one colour


def green(counts: NDArray[np.float32], pattern: str, top: float) -> NDArray[np.float32]:
    """Return the mean of the green pixels of each cell, full where one of them is.

    Files contradict each other about the row from which the cells of a pattern count, which turns
    one diagonal into the other. Where the levels of the pixels tell which two are of one colour,
    they decide.

    Parameters
    ----------
    counts : (height, width) float32 array
        Top row first.
    pattern : str
        One of PATTERNS, of the cell at the top left.
    top : float
        Counts of a full pixel.
    """
    height, width = (size // SPACING * SPACING for size in counts.shape)
    cell = counts[:height, :width].reshape(height // 2, 2, width // 2, 2)
    falling, rising = (cell[:, 0, :, 0], cell[:, 1, :, 1]), (cell[:, 0, :, 1], cell[:, 1, :, 0])
    by_falling, by_rising = _difference(*falling), _difference(*rising)
    is_falling = pattern[0] == 'G'
    if max(by_falling, by_rising) > _SIGMAS + 2.0 * min(by_falling, by_rising):
        is_falling = by_falling < by_rising
    one, other = falling if is_falling else rising
    mean: NDArray[np.float32] = (one + other) / np.float32(2.0)
    mean[(one >= top) | (other >= top)] = top
    return mean


def _difference(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """Return by how many standard errors the levels of two kinds of pixels differ."""
    off = (one - other).ravel()[::7].astype(float)
    off = np.sort(off[np.isfinite(off)])
    off = off[len(off) // 50:len(off) - len(off) // 50]         # without most of the stars
    spread = float(np.std(off)) if len(off) else 0.0
    return float(abs(np.mean(off)) / spread * np.sqrt(len(off))) if spread > 0.0 else 0.0
