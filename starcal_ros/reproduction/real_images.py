# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The star images of others that the studies ``real-sky`` and ``half-real`` need.

They are no part of this package. The environment variable ``STARCAL_REAL_SKY`` names a folder with
a sub-folder for each set, ``tomc16`` and ``granasat``, and in each ``stars.csv``: the identified
stars of its images, as `workflows.still_images.table.read_centroids` reads them; and the images
themselves, where the centroids of this package are compared with those. `sky_cases` has more.
"""

from __future__ import annotations

from dataclasses import dataclass
import os
from pathlib import Path

from starcal_ros.config.parameter import ConfigError
from starcal_ros.workflows.still_images.table import StillImages, read_centroids

VARIABLE = 'STARCAL_REAL_SKY'
"""Environment variable that says where the folder is."""
EPOCH = '2018-01-01T00:00:00'
"""About when the images were taken; a few years move no star by a hundredth of a pixel."""


@dataclass(frozen=True)
class ImageSet:
    """One camera.

    Attributes
    ----------
    name : str
        Sub-folder.
    width, height : int
        Of its images [px].
    fov_deg : float
        Field across the width.
    reference_f_px, reference_rms_px, reference_heldout_px : float
        What the README beside the images has of a bundle fit by others.
    """

    name: str
    width: int
    height: int
    fov_deg: float
    reference_f_px: float
    reference_rms_px: float
    reference_heldout_px: float


SETS = (ImageSet('tomc16', 808, 608, 14.3, 3230.22, 0.096, 0.097),
        ImageSet('granasat', 1280, 960, 27.0, 2657.86, 0.132, 0.134))
HELD_OUT = 4
"""Every so many-th image of a set is held out."""


def folder() -> Path:
    """Return where the images are, or would be.

    Raises
    ------
    ConfigError
        Where the environment variable does not say it.
    """
    if not (name := os.environ.get(VARIABLE, '')):
        needed = ' and '.join(f'{images.name}/stars.csv' for images in SETS)
        raise ConfigError(f'star images of others are needed, which are no part of this package: '
                          f'set {VARIABLE} to a folder that has {needed}')
    return Path(name)


def stars(images: ImageSet) -> StillImages:
    """Return the identified stars of a set.

    Raises
    ------
    ConfigError
        Where they are not there, or nothing says where they are.
    """
    path = folder() / images.name / 'stars.csv'
    if not path.is_file():
        raise ConfigError(f'{path} is not there; {VARIABLE} says where the star images are')
    return read_centroids(path, EPOCH)
