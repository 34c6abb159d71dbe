# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the compiled function takes, changes and gives that does many frames in one call.

Of one run without optional states. Arrays are contiguous and writable; n is the number of states,
16, m that of frames, k that of their stars, end to end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.filter.frame_innovation import CELLS, MAGNITUDES, SUMS
from starcal_ros.filter.responses import WIDTH
from starcal_ros.filter.states import N_STATES


class Values(NamedTuple):
    """What is believed: (1, 3, 3), (1, 3), (1, 3, 3), (1, 7) and (1, n, n) arrays of `Belief`."""

    C_gi: Array
    bias: Array
    C_sg: Array
    intrinsics: Array
    root: Array


class Constants(NamedTuple):
    """What the filter goes by.

    Attributes
    ----------
    density : (13,) array
        Random walks of the calibrated states.
    scale : (n,) array
        Units of the states.
    shift, second, largest : arrays
        Of `Curvature`.
    half : (2,) array
        Half of the detector [px].
    hourly : array
        Of `hypotheses`.
    walk, gap_acceleration, trail_s, pitch_mm, cos_field, gate : float
        Of `Filter`.
    guarded : bool
        Whether a frame is looked at for what the linear model leaves out of it.
    largest_correction, sigma_acquired : float
        Of `error_state`.
    wide, most_torn, torn : float
        Of `acquisition`, and
    least_stars : int
    window : float
        Frames of a window of the tests.
    gated : float
        Of `InnovationTests`.
    sizes : (g, 3) array
        `largest` of `Responses`.
    """

    density: Array
    scale: Array
    shift: Array
    second: Array
    largest: Array
    half: Array
    hourly: Array
    walk: float
    gap_acceleration: float
    trail_s: float
    pitch_mm: float
    cos_field: float
    gate: float
    guarded: bool
    largest_correction: float
    sigma_acquired: float
    wide: float
    most_torn: float
    torn: float
    least_stars: int
    window: float
    gated: float
    sizes: Array


class Intervals(NamedTuple):
    """The gyro's account of the time before each frame: of `Preintegrated`, the bias (3,)."""

    Delta: Array
    J: Array
    duration: Array
    gap_turn: Array
    reading: Array
    share: Array
    bias: Array

    def part(self, begin: int, end: int) -> Intervals:
        """Return those of some of the frames."""
        rows = slice(begin, end)
        return Intervals(self.Delta[rows], self.J[rows], self.duration[rows], self.gap_turn[rows],
                         self.reading[rows], self.share[rows], self.bias)


class StretchStars(NamedTuple):
    """The stars of all frames.

    Attributes
    ----------
    stamp_ns : (m,) int64 array
        Of the frames.
    first : (m + 1,) int64 array
        Where those of each frame begin, and the last end.
    u_i, uv, sigma : (k, 3), (k, 2) and (k,) arrays
        Of `Stars`.
    magnitude : (k,) array
        NaN where it is not known.
    row : (k,) int64 array
        Where the tests keep each.
    """

    stamp_ns: Ints
    first: Ints
    u_i: Array
    uv: Array
    sigma: Array
    magnitude: Array
    row: Ints


class TestSums(NamedTuple):
    """What the tests of the model hold.

    Of `Responses` (one run in front), of `InnovationTests.sums` and of `Changes`.
    """

    E: Array
    s: Array
    information: Array
    run: Array
    window: Array
    last: Array
    follows: Mask
    star_frames: Array
    star_sums: Array
    cell_count: Ints
    cell_squares: Array
    magnitude_count: Ints
    magnitude_squares: Array
    worst: Array
    seen: Ints
    slots: Ints
    counts: Ints


class Gained(NamedTuple):
    """What each frame gave: the values after it, (m, ...), and of `Update` and `TurnFound`.

    ``squares``, (m, 2), are the sums of the squared residuals of the stars used, ``turn``, (m, 3),
    is e of `TurnFound`, NaN where the frame was not judged; ``chi2``, ``accepted`` and
    ``residual`` are (k, ...), of the stars.
    """

    C_gi: Array
    bias: Array
    C_sg: Array
    intrinsics: Array
    root: Array
    nis: Array
    used: Ints
    log_det: Array
    squares: Array
    turn: Array
    chi2: Array
    accepted: Mask
    residual: Array

    def of(self, frames: int, stars: int) -> Gained:
        """Return that of the first frames, and of their stars."""
        return self._replace(
            **{name: part[:stars if name in ('chi2', 'accepted', 'residual') else frames]
               for name, part in self._asdict().items()})

    @classmethod
    def room(cls, frames: int, stars: int) -> Gained:
        """Return room for so many frames and stars."""
        return cls(np.empty((frames, 3, 3)), np.empty((frames, 3)), np.empty((frames, 3, 3)),
                   np.empty((frames, 7)), np.empty((frames, N_STATES, N_STATES)),
                   np.empty(frames), np.empty(frames, np.int64), np.empty(frames),
                   np.empty((frames, 2)), np.empty((frames, 3)),
                   np.empty(stars), np.empty(stars, np.bool_), np.empty((stars, 2)))


def example() -> tuple[Values, Constants, Intervals, StretchStars, TestSums, Gained]:
    """Return what these are made of, for the compiler to see; the numbers mean nothing."""
    a, ints = np.ones, np.ones(1, np.int64)
    return (
        Values(a((1, 3, 3)), a((1, 3)), a((1, 3, 3)), a((1, 7)), a((1, N_STATES, N_STATES))),
        Constants(a(13), a(N_STATES), a(7), a((1, 10, 10)), a((10, 10)), a(2), a((1, 1, 1)),
                  *(1.0,) * 6, True, *(1.0,) * 5, 1, 1.0, 1.0, a((1, WIDTH))),
        Intervals(a((1, 3, 3)), a((1, 3, 3)), a(1), a(1), a((1, 3)), a(1), a(3)),
        StretchStars(ints, ints, a((1, 3)), a((1, 2)), a(1), a(1), ints),
        TestSums(a((1, N_STATES, WIDTH)), a((1, 1, WIDTH)), a((1, 1, WIDTH, WIDTH)), a(SUMS),
                 a(SUMS), a(3), a(1, np.bool_), a(1), a((1, 2)), a(CELLS * CELLS, np.int64),
                 a(CELLS * CELLS), a(len(MAGNITUDES) + 1, np.int64), a(len(MAGNITUDES) + 1), a(3),
                 ints, np.ones((1, 3), np.int64), ints),
        Gained.room(1, 1))
