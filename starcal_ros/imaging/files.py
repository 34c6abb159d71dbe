# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images from files: PNG, TIFF, JPEG through Pillow, FITS through astropy.

Colour becomes luminance (ITU-R BT.601), saturated where any of its channels is. The first row is
the top one, as a viewer shows it: FITS counts rows from the bottom unless its header has a
ROWORDER of TOP-DOWN.
"""

from __future__ import annotations

from datetime import datetime
from io import BytesIO
from os import PathLike
from pathlib import Path
import subprocess
import sys
from typing import Any, NamedTuple
import warnings

from PIL import Image
import numpy as np
from numpy.typing import NDArray

from starcal_ros.files.limits import IMAGE, LimitError
from starcal_ros.imaging import exposure_time, fits_scan
from starcal_ros.imaging.pixels import Scale, grey

FITS_SUFFIXES = ('.fits', '.fit', '.fts')
SUFFIXES = ('.png', '.tif', '.tiff', '.jpg', '.jpeg', *FITS_SUFFIXES)

_UNPACK_S = 120.0
_UNPACK = """
import sys
path, index, *sys.path[:] = sys.argv[1:]
import numpy
from astropy.io import fits
with fits.open(path) as units:
    numpy.save(sys.stdout.buffer, numpy.array(units[int(index)].data))
"""


class ImageFileError(ValueError):
    """A file is no image that can be used; the message names it."""


class Picture(NamedTuple):
    """An image.

    Attributes
    ----------
    counts : (height, width) float32 array
        Top row first.
    scale : Scale
        Its top is where a pixel is saturated.
    taken : datetime or None
        When, as `exposure_time` has it; None where the file does not tell.
    """

    counts: NDArray[np.float32]
    scale: Scale
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
        if path.exists() and not path.is_file():
            raise ValueError('no file')         # a pipe would never end
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')     # what matters is raised
            pixels, scale, taken = _read_fits(path) if is_fits else _read_picture(path)
    except (OSError, LimitError) as error:
        raise ImageFileError(f'{path}: {" ".join(str(error).split())}') from None
    except Exception as error:      # Pillow and astropy raise of every kind on damaged files
        raise ImageFileError(f'{path}: damaged: '
                             f'{" ".join(f"{type(error).__name__} {error}".split())}') from None
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    if pixels.ndim not in (2, 3) or channels > 4 or not pixels.size:
        raise ImageFileError(f'{path}: pixels of shape {pixels.shape}; one image expected, '
                             'grey or with colours')
    counts = pixels.astype(np.float32)
    if channels > 2:
        counts = grey(counts[..., :3], scale.top)      # without alpha
    elif pixels.ndim == 3:
        counts = counts[..., 0]
    return Picture(counts, scale, taken)


def _read_picture(path: Path) -> tuple[NDArray[Any], Scale, datetime | None]:
    with Image.open(path) as picture:
        IMAGE.check(picture.width * picture.height, 'an image')
        coded = picture.mode in ('P', 'CMYK', 'YCbCr', 'LAB', 'HSV')
        pixels = np.asarray(picture.convert('RGB') if coded else picture)
        taken = exposure_time.of_exif(picture.getexif())
        if picture.mode == 'I':             # Pillow reads 16 bits of some formats into 32
            return pixels, Scale(65535.0, 1.0), taken
    return pixels, Scale.of(pixels.dtype), taken


def _read_fits(path: Path) -> tuple[NDArray[Any], Scale, datetime | None]:
    fits_scan.check(path)
    from astropy.io import fits  # here, because it takes a quarter of a second
    with fits.open(path) as units:
        for index, unit in enumerate(units):
            if isinstance(unit, fits.CompImageHDU):
                with fits.open(path, disable_image_compression=True) as tables:
                    fits_scan.check_tiles(tables[index])
                header, pixels = unit.header, _unpack(path, index)
                break
            if unit.is_image and unit.data is not None:
                header, pixels = unit.header, np.array(unit.data)
                break
        else:
            raise ValueError('no image in it')
    scale = Scale.of(pixels.dtype)
    scale = Scale(float(header.get('SATURATE', scale.top)), scale.step)
    order = str(header.get('ROWORDER', 'BOTTOM-UP')).strip().upper()
    if pixels.ndim == 3:
        pixels = np.moveaxis(pixels, 0, -1)     # planes of colour
    if order != 'TOP-DOWN':
        pixels = pixels[::-1]
    return pixels, scale, exposure_time.of_fits(header)


def _unpack(path: Path, index: int) -> NDArray[Any]:
    """Unpack a tile-compressed image in a process of its own.

    astropy's decompressor of HCOMPRESS writes beyond its memory on damaged tiles, which ends the
    process.
    """
    try:
        done = subprocess.run([sys.executable, '-c', _UNPACK, str(path), str(index), *sys.path],
                              stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.DEVNULL, timeout=_UNPACK_S, check=True)
    except subprocess.SubprocessError:
        raise ValueError('its tiles can not be unpacked') from None
    return np.load(BytesIO(done.stdout), allow_pickle=False)
