# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a calibrator gives of frames, one or many in columns, and what it counts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.filter.attitude_track import AttitudeTrack
from starcal_ros.filter.belief import Belief


@dataclass
class Counts:
    """What came in and what became of it."""

    gyro: int = 0                   # readings used
    frames: int = 0                 # frames processed
    stars: int = 0                  # stars used
    rejected_stars: int = 0         # stars outside the gate
    unusable_stars: int = 0         # not finite, behind the camera, or without a catalogue place
    empty_frames: int = 0           # frames without a usable star
    gyro_gaps: int = 0              # silences of the gyro
    missing_gyro: int = 0           # readings that the stamps say are missing
    missing_frames: int = 0         # frames that the stamps say are missing
    dropped_messages: int = 0       # late, duplicate, not finite, waited in vain; all restarts
    acquisitions: int = 0           # times the attitude was found from the stars
    restarts: int = 0               # times the clock was set back and all began again


class FrameResult(NamedTuple):
    """What one frame gave; per star in the order of its message.

    Attributes
    ----------
    stamp_ns : int
        Its stamp.
    belief : Belief
        After the frame.
    uv_raster : (n, 2) array
        Measured centroids [px].
    residual : (n, 2) array
        Measured minus predicted centroid after the update [px]; NaN for an unusable star.
    chi2 : (n,) array
        Normalised innovation squared, two degrees of freedom; NaN likewise.
    accepted : (n,) bool array
        Stars used.
    catalog_id : (n,) int64 array
        Hipparcos numbers.
    sigma : (n,) array
        What the message states of the centroids [px]; 0 for nothing.
    nis : float
        Normalised innovation squared of all stars used, ``2 * accepted.sum()`` degrees of freedom.
    turn : (3,) array
        Whitened turn that explains most of the innovation, `innovation_tests` Eq. (C.1); NaN where
        the frame was not judged.
    linear : bool
        Whether the linear model held; where not, the frame was believed less (`curvature`).
    track : AttitudeTrack
        Attitude at the gyro samples before the frame, from the frame before it, where asked for.
    """

    stamp_ns: int
    belief: Belief
    uv_raster: Array
    residual: Array
    chi2: Array
    accepted: Mask
    catalog_id: Ints
    sigma: Array
    nis: float
    turn: Array
    linear: bool
    track: AttitudeTrack

    @property
    def alone(self) -> FrameResults:
        """The same as that of several frames."""
        return FrameResults(
            np.array([self.stamp_ns]), Belief.stacked([self.belief]),
            np.array([len(self.sigma)]), self.uv_raster, self.residual, self.chi2, self.accepted,
            self.catalog_id, self.sigma, np.array([self.nis]), self.turn[None], self.linear,
            self.track)


@dataclass(frozen=True)
class FrameResults:
    """What some frames gave, in the order of their stamps; the names are those of `FrameResult`.

    Attributes
    ----------
    stamp_ns : (m,) int64 array
    belief : Belief
        Of a batch, (m,): after each frame.
    seen : (m,) int64 array
        Number of stars of each frame.
    uv_raster, residual, chi2, accepted, catalog_id, sigma : (k, ...) arrays
        Of the k stars, end to end.
    nis : (m,) array
    turn : (m, 3) array
    linear : bool
        Of all of them.
    track : AttitudeTrack
        Before the first of them.
    """

    stamp_ns: Ints
    belief: Belief
    seen: Ints
    uv_raster: Array
    residual: Array
    chi2: Array
    accepted: Mask
    catalog_id: Ints
    sigma: Array
    nis: Array
    turn: Array
    linear: bool
    track: AttitudeTrack

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.stamp_ns)

    def __iter__(self) -> Iterator[FrameResult]:
        """Yield what each frame gave."""
        end = 0
        for k, (stamp_ns, seen, nis) in enumerate(zip(
                self.stamp_ns.tolist(), self.seen.tolist(), self.nis.tolist())):
            begin, end = end, end + seen
            yield FrameResult(
                stamp_ns, self.belief.of_run(k), self.uv_raster[begin:end],
                self.residual[begin:end], self.chi2[begin:end], self.accepted[begin:end],
                self.catalog_id[begin:end], self.sigma[begin:end], nis, self.turn[k],
                self.linear, self.track if k == 0 else AttitudeTrack.empty())

    def ending_with(self, belief: Belief) -> FrameResults:
        """Return the same with another belief after the last frame."""
        return replace(self, belief=Belief.joined(
            [self.belief.of_run(slice(-1)), Belief.stacked([belief])]))

    def take(self, frames: slice) -> FrameResults:
        """Return some of them."""
        if frames.indices(len(self)) == (0, len(self), 1):
            return self
        chosen = np.zeros(len(self), bool)
        chosen[frames] = True
        stars = np.repeat(chosen, self.seen)
        return replace(
            self, stamp_ns=self.stamp_ns[frames], belief=self.belief.of_run(frames),
            seen=self.seen[frames], nis=self.nis[frames], turn=self.turn[frames],
            **{name: getattr(self, name)[stars] for name in (
                'uv_raster', 'residual', 'chi2', 'accepted', 'catalog_id', 'sigma')})
