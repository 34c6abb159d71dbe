# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One image as its file has it, and as stars are measured in it: grey, top row first."""

from __future__ import annotations

from datetime import datetime
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros.imaging import mosaic
from starcal_ros.imaging.pixels import Scale, grey


class KindError(ValueError):
    """A file is whole, but of a kind that is not read; the message says how to convert it."""


class Plane(NamedTuple):
    """An image of a file.

    Attributes
    ----------
    pixels : (height, width) or (height, width, channels) array
        Top row first; colours may be followed by an alpha.
    scale : Scale
        What counts they can have.
    taken : datetime or None
        When, as `exposure_time` has it.
    pattern : str
        Colours of a mosaic, as `mosaic` has them; empty where the file tells none.
    note : str
        What a user should know of how the file was taken; mostly empty.
    focal_px : float or None
        Focal length that the file tells, as `focal_hint` has it [px].
    """

    pixels: NDArray[Any]
    scale: Scale
    taken: datetime | None = None
    pattern: str = ''
    note: str = ''
    focal_px: float | None = None


class Picture(NamedTuple):
    """An image in which stars can be measured.

    Attributes
    ----------
    counts : (height, width) float32 array
        Top row first, NaN where nothing is known.
    scale : Scale
        Its top is where a pixel is saturated.
    taken : datetime or None
        When, as `exposure_time` has it; None where the file does not tell.
    spacing : int
        Pixels of the camera from one of `counts` to the next: 2 where those of a colour filter
        were taken together.
    note : str
        What a user should know of how the file was taken; mostly empty.
    focal_px : float or None
        Focal length that the file tells [px].
    """

    counts: NDArray[np.float32]
    scale: Scale
    taken: datetime | None = None
    spacing: int = 1
    note: str = ''
    focal_px: float | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the camera [px]."""
        height, width = self.counts.shape
        return self.spacing * height, self.spacing * width

    @classmethod
    def of(cls, plane: Plane) -> Picture:
        """Return the picture of an image: luminance of colours, the green of a mosaic.

        Raises
        ------
        KindError
            Where it is no image of one to four channels.
        """
        pixels, scale = plane.pixels, plane.scale
        channels = pixels.shape[2] if pixels.ndim == 3 else 1
        if pixels.ndim not in (2, 3) or channels > 4 or not pixels.size:
            raise KindError(f'pixels of shape {pixels.shape}; one image expected, grey or with '
                            'colours')
        with np.errstate(over='ignore'):
            counts = pixels.astype(np.float32)
        if channels > 2:
            counts = grey(counts[..., :3], scale.top)       # without alpha
        elif pixels.ndim == 3:
            counts = counts[..., 0]
        elif pattern := plane.pattern or mosaic.pattern_of(counts):
            told = (f'the green pixels of {pattern} are measured' if plane.pattern else
                    'the pixels lie in a mosaic of colours, which the file does not say: the '
                    'green ones are measured')
            half = None if scale.step is None else scale.step / 2.0
            return cls(mosaic.green(counts, pattern, scale.top), Scale(scale.top, half),
                       plane.taken, mosaic.SPACING, ', '.join(filter(None, (plane.note, told))),
                       plane.focal_px)
        return cls(counts, scale, plane.taken, note=plane.note, focal_px=plane.focal_px)
