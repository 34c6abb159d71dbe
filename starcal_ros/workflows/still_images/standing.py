# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Spots that stand still where the stars do not: hot pixels, dust, lamps, text.

They tell themselves by being at one place of the detector in most images of a folder. In images
of one field, so do the stars: then nothing is left without them, and nothing is told.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from starcal_ros.core.arrays import Mask
from starcal_ros.workflows.still_images.measured import Measured

_LEAST_IMAGES = 3
_LOOKED_AT = 12         # other images, at most
_WITHIN_PX = 1.0
_PART = 0.5             # of the images looked at


def standing(images: Sequence[Measured]) -> dict[str, Mask]:
    """Tell which spots of each image most other images of its size have as well.

    Returns
    -------
    dict of (n,) bool arrays
        By the name of the image; of sizes with two images or less none is told.
    """
    found = {}
    for shape in {image.shape for image in images}:
        those = [image for image in images if image.shape == shape and len(image.centroids.flux)]
        if len(those) < _LEAST_IMAGES:
            continue
        rows = np.unique(np.linspace(0, len(those) - 1, _LOOKED_AT + 1).astype(int))
        trees = {row: cKDTree(those[row].centroids.uv_raster) for row in rows.tolist()}
        for k, image in enumerate(those):
            others = [tree for row, tree in trees.items() if row != k]
            seen = sum(tree.query(image.centroids.uv_raster)[0] < _WITHIN_PX for tree in others)
            found[image.name] = np.asarray(seen >= _PART * len(others))
    return found
