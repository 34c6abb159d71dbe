# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Why an image is not identified, as far as its spots tell."""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Mask
from starcal_ros.imaging.centroids import ELONGATED, SATURATED
from starcal_ros.imaging.spread import rank_in_cell
from starcal_ros.sky import depth
from starcal_ros.workflows.still_images.measured import Measured

_LEAST_SPOTS = 4
_STREAK_PX, _STREAK_SIGMAS = 10.0, 8.0
_MOST = 0.6             # of the spots
_FEW = 12
_CROWDED_CELLS = 0.2    # of all cells, that hold _MOST of the spots


def before(image: Measured) -> str | None:
    """Return why no search is worth while; None where it is."""
    spots = len(image.centroids.flux)
    if spots < _LEAST_SPOTS:
        return (f'not identified: too few spots, {spots}, needs {_LEAST_SPOTS}: too dark, out of '
                'focus, or no sky')
    return None


def after(image: Measured, field_deg: tuple[float, float] | None, is_stated: bool, stands: Mask
          ) -> str:
    """Return why a search in a field may have failed.

    Parameters
    ----------
    image : Measured
    field_deg : (float, float) or None
        Fields of view across the width that were looked for; None where fisheyes alone were.
    is_stated : bool
        Whether the user stated the field.
    stands : (n,) bool array
        Which of its spots most images have, as `standing` tells.
    """
    spots, shape = image.centroids, image.centroids.shape
    count = len(spots.flux)
    said = [f'not identified: {count} spots match no stars of ' + (
        'a fisheye' if field_deg is None else
        f'a field of {field_deg[0]:.3g} to {field_deg[1]:.3g} deg')]
    length = float(np.linalg.norm(spots.streak))
    if length > max(_STREAK_PX, _STREAK_SIGMAS * shape.sigma):
        angle = float(np.degrees(np.arctan2(-spots.streak[1], spots.streak[0]))) % 180.0
        said.append(f'streaked: they are trails of {length:.0f} px at {angle:.0f} deg from the '
                    'row, counter-clockwise; expose shorter, or track')
    saturated = int(np.count_nonzero(spots.flags & SATURATED))
    if saturated > _MOST * count:
        said.append(f'{saturated} of them are saturated: expose shorter')
    _, cells = rank_in_cell(spots.uv_raster, spots.flux, image.shape)
    crowded = np.sort(cells)[::-1][:max(1, round(_CROWDED_CELLS * len(cells)))].sum()
    if crowded > _MOST * count and count > len(cells):
        said.append(f'clustered: {crowded} of them lie in {_CROWDED_CELLS:.0%} of the image: '
                    'foreground, text or a cloud? A mask (--mask) takes it out')
    still = int(np.count_nonzero(stands))
    if _MOST * count < still < count:
        said.append(f'{still} of them are at the same place in most images: hot pixels, dust or '
                    'foreground; a mask (--mask) takes them out')
    long = int(np.count_nonzero(spots.flags & ELONGATED))
    if long > _MOST * count:
        said.append(f'{long} of them are no points: clouds, a galaxy, poor focus, or trails that '
                    'turn')
    if field_deg is None:
        return '; '.join(said)
    area = field_deg[1]**2 * image.shape[0] / image.shape[1]
    if count < _FEW and not is_stated:
        said.append('there are few of them: the field may be too narrow for the catalogue, which '
                    f'has {depth.stars_in(1.0):.1f} stars a square degree')
    elif depth.stars_in(area) < depth.LEAST:
        said.append(f'too narrow for the catalogue: such a field holds {depth.stars_in(area):.1f} '
                    f'of its stars; it would have to reach magnitude {depth.needed(area):.0f}')
    elif not is_stated:
        least = np.sqrt(depth.LEAST / depth.stars_in(1.0) * image.shape[1] / image.shape[0])
        said.append('is the field another one (--fov states it), or narrower than '
                    f'{least:.1f} deg, where the catalogue has fewer than {depth.LEAST} stars?')
    return '; '.join(said)
