# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The reprojection error: RMS residual of the stars used of late, T18 Sec. 3.1."""

from __future__ import annotations

from collections import deque

import numpy as np

from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.units import NS

REPROJECTION_S = 600.0
"""Time over which the reprojection error is taken [s]."""


class Reprojection:
    """The residuals of the last ten minutes."""

    def __init__(self) -> None:
        self._recent: deque[tuple[int, list[float], int]] = deque()

    def add(self, stamp_ns: Ints, squares: Array, used: Ints) -> None:
        """Know of frames: the sums of their squared residuals, (m, 2) [px^2], of so many stars."""
        self._recent.extend(zip(stamp_ns.tolist(), squares.tolist(), used.tolist()))
        since_ns = int(stamp_ns[-1]) - REPROJECTION_S / NS
        while self._recent[0][0] < since_ns:
            self._recent.popleft()

    @property
    def rms_px(self) -> Array:
        """RMS residual of the stars used, u and v, (2,) [px]."""
        squares = np.array([part for _, part, _ in self._recent]).reshape(-1, 2).sum(axis=0)
        return np.sqrt(squares / max(sum(count for *_, count in self._recent), 1))
