# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The light in an image over its background, in units of its own noise.

Counts may be electrons, whole numbers or parts of 1: what comes after this sees no difference.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.arrays import Mask
from starcal_ros.imaging.background import background
from starcal_ros.imaging.full import top_of
from starcal_ros.imaging.pixels import Scale

Image = NDArray[np.float32]

_LEAST_PIXELS = 256
_SPARSE = 16            # background and noise are smooth
_LARGEST = 1e30         # counts: beyond are the marks of programs for a pixel without a value


class Light(NamedTuple):
    """An image less its background.

    Attributes
    ----------
    unit : float
        A typical standard deviation of its noise [counts]: the unit of what follows.
    counts, noise : (height, width) float32 array
        Light, 0 where nothing is known, and the standard deviation of its noise.
    saturated, unknown : (height, width) bool array
        Pixels that are full, and those of which nothing is known.
    """

    unit: float
    counts: Image
    noise: Image
    saturated: Mask
    unknown: Mask

    @classmethod
    def of(cls, image: NDArray[np.generic], saturation: float | None = None,
           scale: Scale | None = None) -> Light:
        """Return the light in an image.

        Parameters
        ----------
        image : (height, width) array
            Counts, any real type, top row first; what is not finite is not known.
        saturation : float, optional
            Counts from which a pixel is full; by default the top of the scale, or less where the
            counts show it themselves.
        scale : Scale, optional
            Of the counts; by default that of the type of the image.

        Raises
        ------
        ValueError
            Where the image is not a plane of 16 by 16 pixels at least, as many of them known.
        """
        if image.ndim != 2 or min(image.shape) < 16:
            raise ValueError(f'image of shape {image.shape}: height and width of 16 or more '
                             'expected')
        scale = scale or Scale.of(image.dtype)
        with np.errstate(over='ignore'):
            counts = image.astype(np.float32)
        unknown = ~(np.abs(counts) < _LARGEST)
        missing = int(np.count_nonzero(unknown))
        if missing > counts.size - _LEAST_PIXELS:
            raise ValueError(f'image with {missing} pixels that are masked or not numbers')
        if missing:
            counts[unknown] = np.nan
        sky = background(counts, scale.step)
        level, unit = (float(np.median(value[::_SPARSE, ::_SPARSE])) for value in sky)
        if saturation is None:
            saturation = min(scale.top, top_of(counts, level, unit))
        saturated = counts >= saturation
        counts -= sky.level
        counts *= np.float32(1.0 / unit)
        if missing:
            counts[unknown] = 0.0
        return cls(unit, counts, sky.noise * np.float32(1.0 / unit), saturated, unknown)
