# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""From which counts on the pixels of an image are full, where its file does not tell.

Full pixels share the largest count of the image, side by side in the middle of the brightest
stars: a camera of 12 bits in a file of 16, or counts that a program has scaled to 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_LEAST_PIXELS = 3
_LEAST_SIGMAS = 20.0            # over the background: noise has equal counts, too


def top_of(counts: NDArray[np.float32], level: float, noise: float) -> float:
    """Return the least count of a full pixel; infinite where no pixel shows itself as full.

    Parameters
    ----------
    counts : (height, width) float32 array
        NaN where nothing is known.
    level, noise : float
        Background, and its standard deviation [counts].
    """
    top = np.fmax.reduce(counts, axis=None)
    if not top > level + _LEAST_SIGMAS * noise:
        return np.inf
    full = counts == top
    beside = (full[1:] & full[:-1]).any() or (full[:, 1:] & full[:, :-1]).any()
    return float(top) if beside and full.sum() >= _LEAST_PIXELS else np.inf
