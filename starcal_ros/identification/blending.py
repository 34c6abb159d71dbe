# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Blends: spots that have the light of more than one star in them, close pairs and trails.

The centroid of a blend is its photocentre, not the place of its brightest star, and its shape
does not always tell: two trails in a line are a longer one. The catalogue does. A star without a
spot of its own, whose image reaches that of another, shifts the photocentre of that by ::

    sum_k F_k (uv_k - uv) / (F + sum_k F_k)                                            (I.3)
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask

_REACH_PX = 3.0         # of the light of a star at rest: four sigmas of a sharp spot


def photocentre_shift(uv: Array, magnitude: Array, trail: Array, seen: Ints) -> Array:
    """Return by how much the spots of some stars are shifted by stars that have none.

    Parameters
    ----------
    uv : (n, 2) array
        Images of all stars [px].
    magnitude : (n,) array
    trail : (n, 2) array
        How far each moves while the exposure lasts [px].
    seen : (m,) int array
        Rows of the stars that have a spot.

    Returns
    -------
    shift : (m, 2) array
        Eq. (I.3) [px].
    """
    hidden: Mask = np.ones(len(uv), bool)
    hidden[seen] = False
    offset = uv[hidden] - uv[seen][:, None]
    along = trail[seen][:, None]
    length2 = np.sum(along**2, axis=-1)
    # Two trails of a like length meet where one, moved along itself by its length, does.
    share = np.clip(np.sum(offset * along, axis=-1) / np.maximum(length2, 1e-12), -1.0, 1.0)
    apart = np.linalg.norm(offset - share[..., None] * along, axis=-1)
    flux = np.where(apart < _REACH_PX,
                    10.0**(-0.4 * (magnitude[hidden] - magnitude[seen][:, None])), 0.0)
    shift: Array = (flux[..., None] * offset).sum(axis=1) / (1.0 + flux.sum(axis=1))[:, None]
    return shift
