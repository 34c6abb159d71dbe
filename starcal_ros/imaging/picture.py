# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One image as its file has it, and as stars are measured in it: grey, top row first."""

from __future__ import annotations

from datetime import datetime
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros.imaging import mosaic
from starcal_ros.imaging.lattice import Lattice
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
    lattice : Lattice or None
        Which pixels of the camera `counts` are, where they are not all.
    note : str
        What a user should know of how the file was taken; mostly empty.
    focal_px : float or None
        Focal length that the file tells [px].
    """

    counts: NDArray[np.float32]
    scale: Scale
    taken: datetime | None = None
    lattice: Lattice | None = None
    note: str = ''
    focal_px: float | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the camera [px]."""
        height, width = self.lattice[:2] if self.lattice else self.counts.shape
        return height, width

    @property
    def shown(self) -> NDArray[np.float32]:
        """Counts of all pixels of the camera, (height, width): of those between, a neighbour's."""
        return self.lattice.shown(self.counts) if self.lattice else self.counts

    def masked(self, mask: NDArray[np.bool_]) -> Picture:
        """Return it with nothing known where a mask of the camera (height, width) is black."""
        kept = self.lattice.of(mask, False) if self.lattice else mask
        return self._replace(counts=np.where(kept, self.counts, np.nan).astype(np.float32))

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
            lattice = mosaic.green(counts, pattern)
            return cls(lattice.of(counts, np.nan), scale, plane.taken, lattice,
                       ', '.join(filter(None, (plane.note, told))), plane.focal_px)
        return cls(counts, scale, plane.taken, note=plane.note, focal_px=plane.focal_px)
