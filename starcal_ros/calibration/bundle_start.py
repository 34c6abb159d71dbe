# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where a bundle adjustment of identified stars begins: their spots, and an attitude a frame."""

from __future__ import annotations

import numpy as np

from starcal_ros.calibration.bundle_problem import MIN_STARS, Observations
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.consensus import OUT_OF_PLACE, consensus
from starcal_ros.measurements.samples import Frames, Stars


def identified(frames: Frames, stars: Stars) -> Observations:
    """Return the stars of known direction, of the frames that have enough of them."""
    use = usable(frames, stars)
    number = np.unique(frames.frame_index[use], return_inverse=True)[1]
    u_i, uv, sigma = stars.take(use)
    return Observations(number, uv, sigma, u_i, np.full(len(number), -1))


def usable(frames: Frames, stars: Stars) -> Mask:
    """Tell which stars have a known direction and are in a frame that has enough of them."""
    use = np.isfinite(stars.sigma)
    return use & (np.bincount(frames.frame_index, use, len(frames))[frames.frame_index]
                  >= MIN_STARS)


def attitudes(spots: Observations, r_s: Array) -> Array:
    """Return the attitude C_si, (n, 3, 3), of each frame by Wahba's problem (Markley 1988).

    A wrong number puts a star anywhere in the sky and so takes the attitude with it: where a star
    is out of place, only those count that agree with the attitude that most of them agree with.

    Parameters
    ----------
    spots : Observations
        Of known direction.
    r_s : (m, 3) array
        Measured directions of the spots.
    """
    counts = np.ones(len(spots.frame))
    C_si = _wahba(spots, r_s, counts)
    first = np.flatnonzero(np.diff(spots.frame, prepend=-1))
    across = np.linalg.norm(r_s - r_s[first][spots.frame], axis=-1)
    allowed = OUT_OF_PLACE * np.maximum.reduceat(across, first)
    u_s = (C_si[spots.frame] @ spots.u_i[..., None])[..., 0]
    out = np.linalg.norm(u_s - r_s, axis=-1) > allowed[spots.frame]
    for k in np.unique(spots.frame[out]):
        rows = spots.frame == k
        agreeing = consensus(spots.u_i[rows], r_s[rows], float(allowed[k]))
        if agreeing.sum() > MIN_STARS:
            counts[rows] = agreeing
    return _wahba(spots, r_s, counts)


def _wahba(spots: Observations, r_s: Array, counts: Array) -> Array:
    B = np.zeros((int(spots.frame[-1]) + 1, 3, 3))
    np.add.at(B, spots.frame, (counts[:, None] * r_s)[:, :, None] * spots.u_i[:, None, :])
    return rotation.wahba(B)
