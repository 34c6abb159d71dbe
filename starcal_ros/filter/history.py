# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How a calibration converged, frame by frame, in a memory that does not grow with the run.

Every frame is kept until there are `MOST`; then every second one of these goes, and of what comes
every second is kept, and so on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core import kalman, rotation
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.frame_result import FrameResults
from starcal_ros.filter.states import N_STATES
from starcal_ros.filter.verdict import equivalent_sigma

MOST = 20_000
"""Frames that are kept at once, at most: nearly 3 h at 2 Hz are kept whole."""

_BLOCK = 500            # frames that are kept as they came, at most


@dataclass(frozen=True)
class Residuals:
    """What the stars of the frames of a history left over, one row a star, in their order.

    Attributes
    ----------
    uv_raster : (m, 2) array
        Measured centroids [px].
    residual : (m, 2) array
        Measured minus predicted centroid after the update [px]; NaN for an unusable star.
    accepted : (m,) bool array
        Stars used.
    sigma : (m,) array
        Standard deviation of the centroid, each axis, that the filter took [px].
    catalog_id : (m,) int64 array
        Hipparcos numbers.
    """

    uv_raster: Array
    residual: Array
    accepted: Mask
    sigma: Array
    catalog_id: Ints


@dataclass(frozen=True)
class History:
    """How the estimates converged: one row a frame, or one of every few of a long run.

    Attributes
    ----------
    every : int
        Frames from one row to the next; the last frame has a row in any case.
    frames : int
        How many there were.
    stamp_ns : (n,) int64 array
        Stamps of the frames.
    bias : (n, 3) array
        Gyro bias [rad/s].
    C_sg : (n, 3, 3) array
        Mounting.
    intrinsics : (n, 7) array
        Camera, as in `starcal_ros.core.camera`.
    sigma : (n, 16) array
        Standard deviations, in the filter's units.
    equivalent_sigma : (n, 2) array
        Standard deviation of the equivalent principal point, Eq. (V.1) of `verdict` [px].
    nis : (n,) array
        Normalised innovation squared of the stars used.
    used : (n,) int64 array
        Number of stars used; nis has twice as many degrees of freedom.
    turn : (n, 3) array
        Whitened turn that explains most of the innovation, `innovation_tests` Eq. (C.1); NaN where
        a frame was not judged.
    seen : (n,) int64 array
        Number of stars of each row in `stars`, used or not.
    stars : Residuals
    turned : (3,) array
        How far the gyros turned about each of their axes from frame to frame, forth and back
        added up, of all frames [rad].
    """

    every: int
    frames: int
    stamp_ns: Ints
    bias: Array
    C_sg: Array
    intrinsics: Array
    sigma: Array
    equivalent_sigma: Array
    nis: Array
    used: Ints
    turn: Array
    seen: Ints
    stars: Residuals
    turned: Array


class _Block(NamedTuple):
    """Rows as arrays, in the order of `History`, and those of their stars."""

    arrays: tuple[Any, ...]
    stars: tuple[Any, ...]

    def thinned(self) -> _Block:
        """Return every other row."""
        kept = np.repeat(np.arange(len(self.arrays[0])) % 2 == 0, self.arrays[-1])
        return _Block(tuple(part[::2] for part in self.arrays),
                      tuple(part[kept] for part in self.stars))


class HistoryKeeper:
    """Keeps what a history needs, while frames are processed.

    Parameters
    ----------
    scenario : Scenario
        For the sigma of stars that state none, and the pixels.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._sigma_px = scenario.star_tracker.centroid_sigma_px
        self._pitch_mm = scenario.camera.pixel_pitch_mm
        self._frames, self._every, self._kept = 0, 1, 0
        self._rows: list[FrameResults] = []
        self._blocks: list[_Block] = []
        self._last: FrameResults | None = None      # where it has no row
        self._C_gi: list[Array] = []                # of the last frames
        self._turned = np.zeros(3)

    def add(self, results: FrameResults) -> None:
        """Take what frames gave."""
        end = 0
        while end < len(results):
            begin, end = end, end + _BLOCK - self._frames % _BLOCK
            self._add(results.take(slice(begin, end)))
            if self._frames % _BLOCK == 0:
                self._add_turns()
                self._end_block()

    def _add(self, results: FrameResults) -> None:
        """Take what frames of one block gave."""
        self._C_gi.append(results.belief.estimate.C_gi)
        rows = results.take(slice(-self._frames % self._every, None, self._every))
        if len(rows):
            self._rows.append(rows)
        self._frames += len(results)
        self._last = results.take(slice(-1, None)) if (
            (self._frames - 1) % self._every) else None

    def history(self, noise_factor: float) -> History:
        """Return the history.

        Parameters
        ----------
        noise_factor : float
            By which the stated sigmas of the stars were multiplied.
        """
        if self._last is not None:
            self._rows.append(self._last)
        self._end_block()
        self._add_turns()
        joined = self._joined()
        uv_raster, residual, accepted, sigma, catalog_id = joined.stars
        sigma = np.where(sigma == 0.0, self._sigma_px, sigma) * noise_factor
        stars = Residuals(uv_raster, residual, accepted, sigma, catalog_id)
        # In the order of `History`, what is no array at its ends.
        values = (self._every, self._frames, *joined.arrays, stars, self._turned.copy())
        return History(*values)

    def _add_turns(self) -> None:
        C_gi = np.concatenate([np.empty((0, 3, 3)), *self._C_gi])
        turns = np.abs(rotation.log(C_gi[1:] @ np.swapaxes(C_gi[:-1], -1, -2)))
        # One after the other, and so the same whatever the block.
        self._turned = np.add.accumulate(np.concatenate((self._turned[None], turns)))[-1]
        self._C_gi = [C_gi[-1:]]

    def _end_block(self) -> None:
        if not self._rows:
            return
        self._blocks.append(_block(self._rows, self._pitch_mm))
        self._kept += sum(map(len, self._rows))
        self._rows = []
        if self._kept >= MOST:
            self._blocks = [self._joined().thinned()]
            self._every *= 2
            self._kept = len(self._blocks[0].arrays[0])

    def _joined(self) -> _Block:
        blocks = [_block([], self._pitch_mm), *self._blocks]
        return _Block(*(tuple(map(np.concatenate, zip(*parts))) for parts in zip(*blocks)))


def _block(rows: list[FrameResults], pitch_mm: float) -> _Block:
    if not rows:
        return _Block((
            np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 7)),
            np.empty((0, N_STATES)), np.empty((0, 2)), np.empty(0), np.empty(0, np.int64),
            np.empty((0, 3)), np.empty(0, np.int64)),
            (np.empty((0, 2)), np.empty((0, 2)), np.empty(0, bool), np.empty(0),
             np.empty(0, np.int64)))

    def joined(name: str) -> Any:
        return np.concatenate([getattr(each, name) for each in rows])
    belief = Belief.joined([each.belief for each in rows])
    estimate, root = belief.estimate, belief.state_root
    seen, accepted = joined('seen'), joined('accepted')
    used = np.diff(np.concatenate(([0], np.cumsum(accepted)))[np.cumsum([0, *seen])])
    return _Block((
        joined('stamp_ns'), estimate.bias, estimate.C_sg, estimate.intrinsics,
        kalman.sigma_of(root), equivalent_sigma(root, estimate.intrinsics, pitch_mm),
        joined('nis'), used, joined('turn'), seen),
        (joined('uv_raster'), joined('residual'), accepted, joined('sigma'),
         joined('catalog_id')))
