# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a calibrator gives of each frame, and what it counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

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
