# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the sensors deliver: gyro samples and star frames, as arrays.

These are the two inputs of every calibration, in the units of the topics that carry them
(``imu/data_raw`` and ``star_tracker/centroids``), whether they come from a simulator, a
recording or a live subscription.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.arrays import Array, Ints, Mask


@dataclass(frozen=True)
class GyroSamples:
    """Gyro readings, in the order in which they arrived.

    Attributes
    ----------
    stamp_ns : (n,) int64 array
        UTC since the Unix epoch; the *end* of the interval that a reading averages.
    rate : (n, 3) float64 array
        Mean angular velocity of g relative to i over that interval, resolved in g [rad/s].
    """

    stamp_ns: Ints
    rate: Array

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def __getitem__(self, rows: slice) -> GyroSamples:
        return GyroSamples(self.stamp_ns[rows], self.rate[rows])

    def take(self, rows: NDArray[Any]) -> GyroSamples:
        """Return some of the samples, given by number or by a mask."""
        return GyroSamples(self.stamp_ns[rows], self.rate[rows])

    def plausible(self, largest_rate: float) -> Mask:
        """Tell which readings are numbers that a gyro of this range [rad/s] gives, (n,)."""
        return np.asarray((np.abs(self.rate) <= largest_rate).all(axis=-1))

    @classmethod
    def empty(cls) -> GyroSamples:
        """Return no samples."""
        return cls(np.empty(0, np.int64), np.empty((0, 3)))

    @classmethod
    def concatenate(cls, parts: Sequence[GyroSamples]) -> GyroSamples:
        """Join batches in the order given."""
        if not parts:
            return cls.empty()
        return cls(np.concatenate([part.stamp_ns for part in parts]),
                   np.concatenate([part.rate for part in parts]))


@dataclass(frozen=True)
class Frames:
    """Star frames, in the order in which they arrived, their stars end to end.

    Frame ``k`` owns the stars ``first[k]:first[k + 1]``; an empty frame owns none.

    Attributes
    ----------
    stamp_ns : (n_frames,) int64 array
        Middle of the exposure, UTC since the Unix epoch.
    first : (n_frames + 1,) int64 array
        Index of each frame's first star, and the number of stars at the end.
    uv_raster : (n_stars, 2) float64 array
        Centroids, (0, 0) the centre of the top-left pixel [px].
    sigma : (n_stars,) float64 array
        Standard deviation of a centroid, each axis [px]; 0 where the sender does not know.
    magnitude : (n_stars,) float64 array
        Hp magnitude, NaN where unknown.
    catalog_id : (n_stars,) int64 array
        Hipparcos number, 0 where not identified.
    """

    stamp_ns: Ints
    first: Ints
    uv_raster: Array
    sigma: Array
    magnitude: Array
    catalog_id: Ints

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def __getitem__(self, rows: slice) -> Frames:
        start, stop, step = rows.indices(len(self))
        if step != 1:
            raise ValueError(f'frames are sliced with step 1, not {step}')
        stop = max(start, stop)
        low, high = self.first[start], self.first[stop]
        return Frames(self.stamp_ns[start:stop], self.first[start:stop + 1] - low,
                      self.uv_raster[low:high], self.sigma[low:high],
                      self.magnitude[low:high], self.catalog_id[low:high])

    def take(self, rows: NDArray[Any]) -> Frames:
        """Return some of the frames, given by number in any order or by a mask."""
        counts = self.star_counts[rows]
        first = np.concatenate(([0], np.cumsum(counts)))
        star = np.repeat(self.first[:-1][rows] - first[:-1], counts) + np.arange(first[-1])
        return Frames(self.stamp_ns[rows], first, self.uv_raster[star], self.sigma[star],
                      self.magnitude[star], self.catalog_id[star])

    @property
    def frame_index(self) -> Ints:
        """Frame of each star, (n_stars,), from 0."""
        return np.repeat(np.arange(len(self)), self.star_counts)

    @property
    def star_counts(self) -> Ints:
        """Number of stars in each frame, (n_frames,)."""
        return np.diff(self.first)

    @classmethod
    def empty(cls) -> Frames:
        """Return no frames."""
        return cls(np.empty(0, np.int64), np.zeros(1, np.int64), np.empty((0, 2)),
                   np.empty(0), np.empty(0), np.empty(0, np.int64))

    @classmethod
    def concatenate(cls, parts: Sequence[Frames]) -> Frames:
        """Join batches in the order given."""
        if not parts:
            return cls.empty()
        counts = np.concatenate([part.star_counts for part in parts])
        return cls(np.concatenate([part.stamp_ns for part in parts]),
                   np.concatenate(([0], np.cumsum(counts))),
                   np.concatenate([part.uv_raster for part in parts]),
                   np.concatenate([part.sigma for part in parts]),
                   np.concatenate([part.magnitude for part in parts]),
                   np.concatenate([part.catalog_id for part in parts]))


class Stars(NamedTuple):
    """The stars of one frame (or of one frame in each run of a batch).

    Attributes
    ----------
    u_i : (..., n, 3) array
        Apparent places, in i; see `star_directions`.
    uv : (..., n, 2) array
        Measured centroids, from the centre of the detector [px].
    sigma : (..., n) array
        Standard deviation of a centroid, each axis [px]; infinite for an excluded one.
    """

    u_i: Array
    uv: Array
    sigma: Array

    def take(self, rows: int | slice | Mask | Ints) -> Stars:
        """Return some of the stars of a frame, or the frame of one run of a batch."""
        return Stars(self.u_i[rows], self.uv[rows], self.sigma[rows])
