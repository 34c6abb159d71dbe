# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames of a recording of any length, evenly spread, in bounded memory."""

from __future__ import annotations

import numpy as np

from starcal_ros.measurements.samples import Frames


class FrameSample:
    """Every frame at first, then every second, every fourth and so on.

    Parameters
    ----------
    most : int
        Frames that are kept, at most; half as many at least.
    """

    def __init__(self, most: int) -> None:
        self._most, self._step, self._seen = most, 1, 0
        self._kept: list[Frames] = []
        self._count = 0

    def add(self, frames: Frames) -> None:
        """Take frames, in order."""
        number = np.arange(self._seen, self._seen + len(frames))
        self._seen += len(frames)
        self._append(frames.take(number % self._step == 0))
        while self._count > self._most:
            self._step *= 2
            kept = self.frames
            self._kept, self._count = [], 0
            self._append(kept.take(np.arange(0, len(kept), 2)))

    @property
    def frames(self) -> Frames:
        """Those that are kept."""
        return Frames.concatenate(self._kept)

    def _append(self, frames: Frames) -> None:
        if len(frames):
            self._kept.append(frames)
            self._count += len(frames)
