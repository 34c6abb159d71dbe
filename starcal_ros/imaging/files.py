# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images from files: PNG, TIFF, JPEG through Pillow, FITS through astropy.

Colour becomes luminance (ITU-R BT.601), saturated where any of its channels is. The first row is
the top one, as a viewer shows it: FITS counts rows from the bottom unless its header has a
ROWORDER of TOP-DOWN.
"""

from __future__ import annotations

from datetime import datetime
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple
import warnings

from PIL import Image
import numpy as np
from numpy.typing import NDArray

from starcal_ros.imaging import exposure_time
from starcal_ros.imaging.pixels import grey, top

FITS_SUFFIXES = ('.fits', '.fit', '.fts')
SUFFIXES = ('.png', '.tif', '.tiff', '.jpg', '.jpeg', *FITS_SUFFIXES)


class ImageFileError(ValueError):
    """A file is no image that can be used; the message names it."""


class Picture(NamedTuple):
    """An image.

    Attributes
    ----------
    counts : (height, width) float32 array
        Top row first.
    saturation : float
        Counts from which a pixel is saturated; infinite where the file does not tell.
    taken : datetime or None
        When, as `exposure_time` has it; None where the file does not tell.
    """

    counts: NDArray[np.float32]
    saturation: float
    taken: datetime | None = None


def image_files(folder: str | PathLike[str]) -> list[Path]:
    """Return the images of a folder, in the order of their names.

    Raises
    ------
    ImageFileError
        Where it is no folder or holds no image.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ImageFileError(f'{folder}: a folder of images expected')
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not files:
        raise ImageFileError(f'{folder}: no image in it; one of {", ".join(SUFFIXES)} expected')
    return files


def load(path: str | PathLike[str]) -> Picture:
    """Read an image.

    Raises
    ------
    ImageFileError
        Where the file is missing, damaged, or no single image of one to four channels.
    """
    path = Path(path)
    is_fits = path.suffix.lower() in FITS_SUFFIXES
    try:
        pixels, saturation, taken = _read_fits(path) if is_fits else _read_picture(path)
    # What Pillow raises, and what `_read_fits` makes of astropy's.
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise ImageFileError(f'{path}: {" ".join(str(error).split())}') from None
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    if pixels.ndim not in (2, 3) or channels > 4 or not pixels.size:
        raise ImageFileError(f'{path}: pixels of shape {pixels.shape}; one image expected, '
                             'grey or with colours')
    counts = pixels.astype(np.float32)
    if channels > 2:
        counts = grey(counts[..., :3], saturation)      # without alpha
    elif pixels.ndim == 3:
        counts = counts[..., 0]
    if not np.isfinite(counts).all():
        raise ImageFileError(f'{path}: {np.sum(~np.isfinite(counts))} pixels are not numbers')
    return Picture(counts, saturation, taken)


def _read_picture(path: Path) -> tuple[NDArray[Any], float, datetime | None]:
    with Image.open(path) as picture:
        coded = picture.mode in ('P', 'CMYK', 'YCbCr', 'LAB', 'HSV')
        pixels = np.asarray(picture.convert('RGB') if coded else picture)
        taken = exposure_time.of_exif(picture.getexif())
        if picture.mode == 'I':             # Pillow reads 16 bits of some formats into 32
            return pixels, 65535.0, taken
    return pixels, top(pixels.dtype), taken


def _read_fits(path: Path) -> tuple[NDArray[Any], float, datetime | None]:
    from astropy.io import fits  # here, because it takes a quarter of a second
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')         # what matters is raised
            with fits.open(path) as units:
                for unit in units:
                    if unit.is_image and unit.data is not None:
                        header, pixels = unit.header, np.array(unit.data)
                        break
                else:
                    raise ValueError('no image in it')
        saturation = float(header.get('SATURATE', top(pixels.dtype)))
        order = str(header.get('ROWORDER', 'BOTTOM-UP')).strip().upper()
    except (TypeError, LookupError, fits.VerifyError) as error:
        raise ValueError(f'damaged: {type(error).__name__} {error}') from None
    if pixels.ndim == 3:
        pixels = np.moveaxis(pixels, 0, -1)     # planes of colour
    if order != 'TOP-DOWN':
        pixels = pixels[::-1]
    return pixels, saturation, exposure_time.of_fits(header)
