# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which images are the same exposure once more: a copy, whatever format or scale of its counts.

Two exposures have noise of their own, so that the places of their stars differ by what the sigmas
say; those of a copy differ by less::

    sum |uv_a - uv_b|^2  <  RATIO^2 sum 2 (sigma_a^2 + sigma_b^2)      over the stars of both

A copy counted as an exposure would make the sigmas of the camera too small, and where it is held
out, judge the camera by what was fitted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from starcal_ros.core.arrays import Array, Ints

RATIO = 0.4
"""Two exposures are at 1, at 0.6 where the sigmas are too large as those of JPEG; copies in 8 bits
at 0.01, with a curve of brightness at 0.3, as JPEG of quality 80 at 0.2."""
COPY = 'the same picture as {}: its stars are where they are there, closer than noise allows'
LEAST_STARS = 8
"""Fewer that two images have in common tell nothing."""

_LEAST_PART = 0.5       # of the stars of the image of fewer ones, that the other has as well
_LEAST_SIGMA_PX = 1e-3  # of tables that state none
_BLOCK = 256            # images compared with all others at a time: films have thousands


def originals(uv_raster: Sequence[Array], sigma: Sequence[Array], catalog_id: Sequence[Ints]
              ) -> Ints:
    """Return the row (n,) of the image of which each is a copy, its own where it is none.

    Of the copies of an exposure the one of most stars is taken for it.

    Parameters
    ----------
    uv_raster : n (m, 2) arrays
        Stars of images of one camera [px].
    sigma : n (m,) arrays
        Standard deviation of each, 0 where it is not known [px].
    catalog_id : n (m,) int arrays
        Numbers of the stars, 0 where there is none.
    """
    counts = np.array([len(np.unique(number[number != 0])) for number in catalog_id])
    known, (u, v), variance = _by_star(uv_raster, sigma, catalog_id)
    square = u.multiply(u) + v.multiply(v)
    alike: list[Ints] = []
    for low in range(0, len(counts), _BLOCK):
        part = slice(low, low + _BLOCK)
        common = (known[part] @ known.T).toarray()
        apart = (square[part] @ known.T + known[part] @ square.T
                 - 2.0 * (u[part] @ u.T + v[part] @ v.T)).toarray()
        expected = 2.0 * (variance[part] @ known.T + known[part] @ variance.T).toarray()
        alike.extend(np.flatnonzero(row) for row in (apart < RATIO**2 * expected) & (
            common >= LEAST_STARS) & (
                common >= _LEAST_PART * np.minimum(counts[part, None], counts)))
    rows = np.arange(len(counts))
    taken = np.zeros(len(counts), bool)
    for row in np.argsort(-counts, kind='stable'):
        if not taken[row]:
            mine = alike[row][~taken[alike[row]]]
            rows[mine], taken[mine] = row, True
            rows[row], taken[row] = row, True
    return rows


def _by_star(uv_raster: Sequence[Array], sigma: Sequence[Array], catalog_id: Sequence[Ints]
             ) -> tuple[sparse.csr_array, tuple[sparse.csr_array, ...], sparse.csr_array]:
    """Return where stars are known, their places and variances, (images, stars) each."""
    first = [np.unique(number, return_index=True)[1] for number in catalog_id]
    image = np.repeat(np.arange(len(first)), [len(rows) for rows in first])
    star = np.concatenate([number[rows] for number, rows in zip(catalog_id, first)])
    uv = np.concatenate([places[rows] for places, rows in zip(uv_raster, first)])
    error = np.maximum(np.concatenate([value[rows] for value, rows in zip(sigma, first)]),
                       _LEAST_SIGMA_PX)
    _, column = np.unique(star, return_inverse=True)
    named = star != 0

    def matrix(values: Array) -> sparse.csr_array:
        return sparse.csr_array((values[named], (image[named], column[named])),
                                shape=(len(first), column.max(initial=0) + 1))

    return (matrix(np.ones(len(star))), tuple(matrix(axis - np.mean(axis)) for axis in uv.T),
            matrix(error**2))
