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
from starcal_ros.filter.frame_result import FrameResult
from starcal_ros.filter.states import N_STATES
from starcal_ros.filter.verdict import equivalent_sigma
from starcal_ros.measurements.samples import Frames

MOST = 20_000
"""Frames that are kept at once, at most: nearly 3 h at 2 Hz are kept whole."""

_BLOCK = 500            # frames whose covariances are looked at together
_WAITING = 50_000       # frames whose result is still to come: more than a calibrator keeps


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


_Stars = tuple[Array, Array, Mask, Array, Ints]


class _Row(NamedTuple):
    """What is kept of a frame; its stars are copied, since a part of a batch holds all of it."""

    stamp_ns: int
    belief: Belief
    nis: float
    turn: Array
    stars: _Stars


class _Block(NamedTuple):
    """Rows as arrays, in the order of `History`, and the stars of each."""

    arrays: tuple[Any, ...]
    stars: list[_Stars]


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
        self._rows: list[_Row] = []
        self._blocks: list[_Block] = []
        self._last: tuple[FrameResult, Array] | None = None
        self._stated: dict[int, Array] = {}         # sigmas of the stars, by the frame's stamp
        self._C_gi: list[Array] = []                # of the last frames
        self._turned = np.zeros(3)

    def expect(self, frames: Frames) -> None:
        """Take frames before they are processed: what they state of their stars."""
        for stamp_ns in list(self._stated)[:max(len(self._stated) - _WAITING, 0)]:
            del self._stated[stamp_ns]
        for k, stamp_ns in enumerate(frames.stamp_ns.tolist()):
            # Of frames with the same stamp the first is used: the others are not newer.
            self._stated.setdefault(stamp_ns, frames.sigma[frames.first[k]:frames.first[k + 1]])

    def add(self, frame: FrameResult) -> None:
        """Take what a frame gave."""
        stated = self._stated.pop(frame.stamp_ns)
        self._C_gi.append(frame.belief.estimate.C_gi)
        if len(self._C_gi) == _BLOCK:
            self._add_turns()
        if self._frames % self._every == 0:
            self._rows.append(_row(frame, stated))
            self._last = None
        else:
            self._last = frame, stated
        self._frames += 1
        if len(self._rows) == _BLOCK:
            self._end_block()

    def history(self, noise_factor: float) -> History:
        """Return the history.

        Parameters
        ----------
        noise_factor : float
            By which the stated sigmas of the stars were multiplied.
        """
        if self._last is not None:
            self._rows.append(_row(*self._last))
        self._end_block()
        self._add_turns()
        joined = self._joined()
        nothing = (np.empty((0, 2)), np.empty((0, 2)), np.empty(0, bool), np.empty(0),
                   np.empty(0, np.int64))
        uv_raster, residual, accepted, sigma, catalog_id = (
            np.concatenate(parts) for parts in zip(nothing, *joined.stars))
        sigma = np.where(sigma == 0.0, self._sigma_px, sigma) * noise_factor
        stars = Residuals(uv_raster, residual, accepted, sigma, catalog_id)
        # In the order of `History`, what is no array at its ends.
        values = (self._every, self._frames, *joined.arrays, stars, self._turned.copy())
        return History(*values)

    def _add_turns(self) -> None:
        C_gi = np.array(self._C_gi).reshape(-1, 3, 3)
        for turn in np.abs(rotation.log(C_gi[1:] @ np.swapaxes(C_gi[:-1], -1, -2))):
            self._turned += turn            # one by one: the same whatever the block
        self._C_gi = self._C_gi[-1:]

    def _end_block(self) -> None:
        if not self._rows:
            return
        self._blocks.append(_block(self._rows, self._pitch_mm))
        self._kept += len(self._rows)
        self._rows = []
        if self._kept >= MOST:
            arrays, stars = self._joined()
            self._blocks = [_Block(tuple(part[::2] for part in arrays), stars[::2])]
            self._every *= 2
            self._kept = len(stars[::2])

    def _joined(self) -> _Block:
        blocks = [_block([], self._pitch_mm), *self._blocks]
        return _Block(tuple(map(np.concatenate, zip(*(each.arrays for each in blocks)))),
                      [stars for each in blocks for stars in each.stars])


def _row(frame: FrameResult, stated: Array) -> _Row:
    return _Row(frame.stamp_ns, frame.belief, frame.nis, frame.turn,
                (frame.uv_raster.copy(), frame.residual.copy(), frame.accepted.copy(),
                 stated.copy(), frame.catalog_id.copy()))


def _block(rows: list[_Row], pitch_mm: float) -> _Block:
    if not rows:
        return _Block((
            np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 7)),
            np.empty((0, N_STATES)), np.empty((0, 2)), np.empty(0), np.empty(0, np.int64),
            np.empty((0, 3)), np.empty(0, np.int64)), [])
    belief = Belief.stacked([row.belief for row in rows])
    estimate, root = belief.estimate, belief.state_root
    return _Block((
        np.array([row.stamp_ns for row in rows]), estimate.bias, estimate.C_sg,
        estimate.intrinsics, kalman.sigma_of(root),
        equivalent_sigma(root, estimate.intrinsics, pitch_mm),
        np.array([row.nis for row in rows]),
        np.array([row.stars[2].sum() for row in rows]), np.array([row.turn for row in rows]),
        np.array([len(row.stars[0]) for row in rows])), [row.stars for row in rows])
