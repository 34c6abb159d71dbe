# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images of stars on the true detector, and when to look while an exposure lasts.

Integrals over an exposure are Gauss-Lobatto sums of five points, exact for polynomials in time up
to the seventh power.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from starcal_ros.core.arrays import Array, Ints

WEIGHTS = np.array([9.0, 49.0, 64.0, 49.0, 9.0]) / 180.0
"""Of the `instants_ns` in a mean over the exposure."""

_NODES = np.array([-1.0, -np.sqrt(3.0 / 7.0), 0.0, np.sqrt(3.0 / 7.0), 1.0]) / 2.0


def instants_ns(exposure_s: float) -> list[int]:
    """Return when to look, from the middle of the exposure [ns]."""
    return np.rint(_NODES * exposure_s * 1e9).astype(int).tolist()


@dataclass(frozen=True)
class ImagedStars:
    """Where the stars of some frames fall on the detector, before noise.

    Attributes
    ----------
    middle_ns : (n_frames,) int64 array
        Middle of each exposure, UTC since the Unix epoch.
    frame : (n,) int64 array
        Row of the frame of each star.
    uv : (n, 2) array
        Its image from the centre of the detector, in the middle of the exposure at first [px].
    trail : callable
        Returns its images (5, n, 2) at the `instants_ns` of the exposure [px].
    noise_factor : (n, 2, 2) array, optional
        Multiplies the noise of its centroid.
    """

    middle_ns: Ints
    frame: Ints
    uv: Array
    trail: Callable[[], Array]
    noise_factor: Array | None = None
