# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A random process as a function of time: drawn on a grid for the whole run, linear between.

Whoever asks, in whatever order, gets the same value at the same stamp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import NS


@dataclass(frozen=True)
class Process:
    """Three components, one a column.

    Attributes
    ----------
    origin_ns : int
        Stamp of the first grid point.
    step : float
        Time between grid points [s].
    value : (n, 3) array
        At the grid points; beyond the ends the process stands still.
    """

    origin_ns: int
    step: float
    value: Array

    def at(self, stamps_ns: Ints) -> Array:
        """Return the values, (n, 3), at each stamp."""
        grid = self.step * np.arange(len(self.value))
        t = (stamps_ns - self.origin_ns) * NS
        return np.stack([np.interp(t, grid, column) for column in self.value.T], axis=-1)
