# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Every other pixel of an image, as those of one colour of a chessboard, as an image of its own.

The green pixels of a colour filter array lie so. Turned by 45 deg they are a square lattice of
sqrt(2) pixels without a gap: stars are measured in it as in any image, and nothing has to be
interpolated, added up or left away. Of its corners, beyond the image, nothing is known.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.arrays import Array

_AXES = np.array([[1.0, 1.0], [-1.0, 1.0]])


class Lattice(NamedTuple):
    """Which pixels of an image.

    The one in column i and row j of the lattice is, with l its diagonals right of the first, ::

        u = i - j + l + odd,    v = i + j - l,    l = floor((width - 1 - odd) / 2)      (LT.1)

    Attributes
    ----------
    height, width : int
        Of the image [px].
    odd : int
        Whether row and column of a pixel add up to an odd number, 0 or 1.
    """

    height: int
    width: int
    odd: int

    def of(self, image: NDArray[Any], beyond: Any) -> NDArray[Any]:
        """Return its pixels of an image (height, width), and `beyond` in its corners."""
        columns = (self.width + self.height - 2 - self.odd) // 2 + 1
        rows = self._last + (self.height - 1 + self.odd) // 2 + 1
        found = np.full((rows, columns), beyond, image.dtype)
        for part, at in self._parts():
            found[at] = image[part]
        return found

    def shown(self, pixels: NDArray[Any]) -> NDArray[Any]:
        """Return an image (height, width) of its pixels, each for the next one in its row, too."""
        image = np.empty((self.height, self.width), pixels.dtype)
        for part, at in self._parts():
            image[part] = pixels[at]
        for v in (0, 1):
            first = (v + self.odd) % 2
            between, beside = image[v::2, 1 - first::2], image[v::2, first::2]
            between[:] = beside[:, np.minimum(np.arange(between.shape[1]), beside.shape[1] - 1)]
        return image

    def places(self, at: Array) -> Array:
        """Return the places (n, 2) in the image of places (column, row) in the lattice [px]."""
        return at @ _AXES + [self._last + self.odd, -self._last]

    def covariance(self, covariance: Array) -> Array:
        """Return the covariance (n, 2, 2) in the image of one in the lattice."""
        found: Array = _AXES.T @ covariance @ _AXES
        return found

    def vector(self, vector: Array) -> Array:
        """Return the vector (2,) in the image of one in the lattice."""
        found: Array = vector @ _AXES
        return found

    @property
    def _last(self) -> int:
        return (self.width - 1 - self.odd) // 2

    def _parts(self) -> Iterator[tuple[tuple[slice, slice], tuple[NDArray[Any], NDArray[Any]]]]:
        """Yield even and odd rows of the image, and the rows and columns where they are in it."""
        for first in (0, 1):
            v = np.arange(first, self.height, 2)[:, None]
            begin = (first + self.odd) % 2
            u = np.arange(begin, self.width, 2)
            yield ((slice(first, None, 2), slice(begin, None, 2)),
                   (self._last - (u - v - self.odd) // 2, (u + v - self.odd) // 2))
