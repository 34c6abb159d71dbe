# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Raw files of cameras, through rawpy (LibRaw): the pixels as the detector gave them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from datetime import datetime
from importlib import import_module
from pathlib import Path

from PIL import Image
import numpy as np

from starcal_ros.files.limits import IMAGE
from starcal_ros.imaging import exposure_time, focal_hint
from starcal_ros.imaging.mosaic import PATTERNS
from starcal_ros.imaging.picture import KindError, Plane
from starcal_ros.imaging.pixels import Scale

SUFFIXES = ('.dng', '.cr2', '.cr3', '.crw', '.nef', '.nrw', '.arw', '.sr2', '.srf', '.orf', '.rw2',
            '.rwl', '.raf', '.pef', '.srw', '.x3f', '.3fr', '.fff', '.iiq', '.erf', '.kdc', '.dcr',
            '.mrw', '.gpr')


def read(path: Path) -> Iterator[Plane]:
    """Yield the image of a raw file.

    Raises
    ------
    ImportError
        Where rawpy is missing.
    KindError
        Where its colour filters are not those of Bayer.
    """
    try:
        rawpy = import_module('rawpy')
    except ImportError:
        raise ImportError("to read raw files, rawpy is needed: pip install 'starcal_ros[raw]' (or "
                          'convert it to 16-bit TIFF or FITS, without scaling or sharpening)'
                          ) from None
    with rawpy.imread(str(path)) as raw:
        pixels = np.array(raw.raw_image_visible)
        IMAGE.check(pixels.size, 'an image')
        pattern = ''
        if pixels.ndim == 2 and raw.raw_pattern is not None:
            colours = raw.color_desc.decode()
            pattern = ''.join(colours[k] for k in raw.raw_colors_visible[:2, :2].ravel())
            if pattern not in PATTERNS or raw.raw_pattern.shape != (2, 2):
                raise KindError(f'colour filters {pattern} of {raw.raw_pattern.shape}, those of '
                                'Bayer are read: convert it to 16-bit TIFF')
        taken, focal_px = _told(path, pixels.shape[1], pixels.shape[0])
        yield Plane(pixels, Scale(float(raw.white_level), 1.0), taken, pattern, focal_px=focal_px)


def _told(path: Path, width: int, height: int) -> tuple[datetime | None, float | None]:
    """Return when it was taken, and the focal length; most raw files are TIFF outside."""
    with suppress(Exception), Image.open(path) as picture:
        exif = picture.getexif()
        return exposure_time.of_exif(exif), focal_hint.of_exif(exif, width, height)
    return None, None
