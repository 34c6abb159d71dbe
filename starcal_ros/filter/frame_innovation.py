# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a frame adds to the tests of the innovations, and the sums that it is added to.

The model stands in `innovation_tests`, Eq. (C.1) and (C.2).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints

SPREAD = 1000.0
"""Largest predicted spread of a centroid that is judged, in its sigmas: of coarse gyros before a
precise camera it is some ten in each frame, and such frames tell of the model as others do."""
BLIND = 1e-10
"""Information on a turn that a frame has none of, of its largest."""
CELLS = 4
"""Cells of the detector along each of its sides."""
MAGNITUDES = (3.0, 4.0, 5.0, 6.0, 7.0)
"""Where the kinds of stars by magnitude end."""

FRAMES, FREEDOM, PAIRS, TURN, REST, LAG, ALONG, RATE = range(8)
"""Places of the sums: of frames, degrees of freedom of the rest, frames that follow one; of the
squares of turn and rest, e_k . e_k-1, w' A'S^-1 z and w' N w."""
E = slice(8, 11)
"""Place of the sum of e."""
SUMS = 11
"""Number of sums."""


class FrameInnovation(NamedTuple):
    """What a frame adds.

    Attributes
    ----------
    e : (3,) array
        Whitened turn, Eq. (C.1).
    L : (3, 3) array
        Root of its information [1/rad].
    nis : float
        z' S^-1 z of the stars used.
    used : int
        Their number.
    rate : (3,) array
        Rate of the camera, in s [rad/s].
    catalog_id : (n,) int64 array
        Catalogue numbers of the stars used.
    normal : (n, 2) array
        Their innovations, each coordinate divided by its standard deviation.
    cell : (n,) int array
        Where they are on the detector, row by row of CELLS.
    magnitude : (n,) array
        NaN where it is not known.
    noise : float
        The first of `hypotheses.drawn`'s [rad^2/s]: on average it takes ``noise tr N`` off
        ``w' A'S^-1 z``.
    """

    e: Array
    L: Array
    nis: float
    used: int
    rate: Array
    catalog_id: Ints
    normal: Array
    cell: Ints
    magnitude: Array
    noise: float


def tally(frame: FrameInnovation, run: Array, window: Array, last: Array, follows: bool,
          rows: Ints, star_frames: Array, star_sums: Array, cell_count: Ints, cell_squares: Array,
          magnitude_count: Ints, magnitude_squares: Array) -> None:
    """Add a frame to all sums, in place.

    Parameters
    ----------
    frame : FrameInnovation
    run, window : (SUMS,) arrays
    last : (3,) array
        e of the frame before; this one's afterwards.
    follows : bool
        Whether that was the one just before.
    rows : (n,) int64 array
        Where the stars stand.
    star_frames, star_sums : (m,) and (m, 2) arrays
        Number of frames, and sums of the coordinates, of each star.
    cell_count, cell_squares, magnitude_count, magnitude_squares : arrays
        Number of stars of each kind, and sums of their squares.
    """
    turn, w = float(frame.e @ frame.e), frame.rate @ frame.L
    for sums in (run, window):
        sums[[FRAMES, FREEDOM, TURN, REST, ALONG, RATE]] += (
            1.0, 2 * frame.used - 3, turn, frame.nis - turn,
            float(w @ frame.e) + frame.noise * float(np.sum(frame.L**2)), float(w @ w))
        sums[E] += frame.e
        if follows:
            sums[[PAIRS, LAG]] += 1.0, float(frame.e @ last)
    last[:] = frame.e
    np.add.at(star_frames, rows, 1.0)
    np.add.at(star_sums, rows, frame.normal)
    squares = np.sum(frame.normal**2, axis=-1)
    known = np.isfinite(frame.magnitude)
    for kind, square, count, total in (
            (frame.cell, squares, cell_count, cell_squares),
            (np.searchsorted(MAGNITUDES, frame.magnitude[known]), squares[known],
             magnitude_count, magnitude_squares)):
        count += np.bincount(kind, minlength=len(count))
        total += np.bincount(kind, square, len(count))


def cell_of(uv: Array, half: Array) -> Ints:
    """Return the cell of centroids (..., 2) from the centre of a detector of half the size."""
    place = np.clip(((uv / half + 1.0) * (0.5 * CELLS)).astype(np.int64), 0, CELLS - 1)
    return np.asarray(CELLS * place[..., 1] + place[..., 0])
