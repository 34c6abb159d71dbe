# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Pixels of colour as counts, and the largest count of a type."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_LUMINANCE = np.array([0.299, 0.587, 0.114])


def grey(colour: NDArray[np.float32], saturation: float) -> NDArray[np.float32]:
    """Return the luminance of an image (height, width, 3), full where a channel is."""
    counts = colour @ _LUMINANCE.astype(np.float32)
    counts[colour.max(axis=-1) >= saturation] = saturation
    return counts


def top(kind: np.dtype[Any]) -> float:
    """Return the largest count of a type of pixels; infinite where they are not whole."""
    return float(np.iinfo(kind).max) if np.issubdtype(kind, np.integer) else np.inf
