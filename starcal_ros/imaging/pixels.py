# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Pixels of colour as counts, and what counts a type can hold."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_LUMINANCE = np.array([0.299, 0.587, 0.114])


class Scale(NamedTuple):
    """What counts pixels can have.

    Attributes
    ----------
    top : float
        The largest; infinite where nobody knows.
    step : float or None
        From one to the next; None where nobody knows.
    """

    top: float
    step: float | None

    @classmethod
    def of(cls, kind: np.dtype[Any]) -> Scale:
        """Return what a type can hold."""
        return cls(top(kind), 1.0 if np.issubdtype(kind, np.integer) else None)


def grey(colour: NDArray[np.float32], saturation: float) -> NDArray[np.float32]:
    """Return the luminance of an image (height, width, 3), full where a channel is."""
    counts = colour @ _LUMINANCE.astype(np.float32)
    red, green, blue = np.moveaxis(colour, -1, 0)       # the maximum along an axis of 3 is slow
    counts[np.maximum(np.maximum(red, green), blue) >= saturation] = saturation
    return counts


def top(kind: np.dtype[Any]) -> float:
    """Return the largest count of a type of pixels; infinite where they are not whole."""
    return float(np.iinfo(kind).max) if np.issubdtype(kind, np.integer) else np.inf
