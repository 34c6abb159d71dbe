# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images from files of any kind that is read; what is not says how to convert it.

A file may hold several images: pages of TIFF, planes of FITS, frames of a film. Colour becomes
luminance (ITU-R BT.601), saturated where any of its channels is; a colour filter array its green.
The first row is the top one, as a viewer shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path
import warnings

from starcal_ros.files.limits import LimitError
from starcal_ros.imaging import fits_file, pillow_file, raw_file, ser_file
from starcal_ros.imaging.picture import KindError, Picture, Plane

READERS: tuple[tuple[tuple[str, ...], Callable[[Path], Iterator[Plane]]], ...] = (
    (fits_file.SUFFIXES, fits_file.read), (pillow_file.SUFFIXES, pillow_file.read),
    (raw_file.SUFFIXES, raw_file.read), (('.ser',), ser_file.read))
"""Endings of names, and what reads such files."""
SUFFIXES = tuple(suffix for suffixes, _ in READERS for suffix in suffixes)

KINDS = 'PNG, TIFF, JPEG, BMP, PGM, WebP, AVIF, HEIC, FITS (.fz, .gz), SER, raw'

_FRAMES = ('is a film: write its frames as images, such as by ffmpeg -i FILE -pix_fmt gray16be '
           'frame%04d.png')
_CONVERT = {'.xisf': 'PixInsight: save it as FITS',
            **{suffix: 'save it as PNG or 16-bit TIFF' for suffix in (
                '.psd', '.xcf', '.jxl', '.jp2', '.j2k', '.jxr', '.exr', '.gif', '.tga', '.svg',
                '.pdf', '.dcm')},
            **{suffix: 'numbers without a head: save them as FITS (astropy.io.fits.writeto)'
               for suffix in ('.npy', '.npz', '.mat', '.h5', '.hdf5', '.raw')},
            **{suffix: _FRAMES for suffix in (
                '.avi', '.mp4', '.mov', '.mkv', '.webm', '.wmv', '.mts', '.m4v', '.mpg')}}
"""Images that are not read, and how they can be."""


class ImageFileError(ValueError):
    """A file is no image that can be used; the message names it."""


def is_image(name: str | PathLike[str]) -> bool:
    """Tell whether a file is an image by its name, whether of a kind that is read or not."""
    return str(name).lower().endswith((*SUFFIXES, *_CONVERT))


def image_files(folder: str | PathLike[str]) -> list[Path]:
    """Return the images of a folder, in the order of their names; also those that are not read.

    Raises
    ------
    ImageFileError
        Where it is no folder or holds no image.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ImageFileError(f'{folder}: a folder of images expected')
    files = sorted(path for path in folder.iterdir() if is_image(path.name))
    if not files:
        raise ImageFileError(f'{folder}: no image in it; {KINDS} expected')
    return files


def load(path: str | PathLike[str]) -> Picture:
    """Read the image of a file, or the first of several; as `pictures`."""
    return next(pictures(path))


def pictures(path: str | PathLike[str]) -> Iterator[Picture]:
    """Read the images of a file, one after the other.

    Raises
    ------
    ImageFileError
        Where the file is missing, damaged, of no kind that is read, or has no image.
    """
    path = Path(path)
    read = next((read for suffixes, read in READERS if path.name.lower().endswith(suffixes)),
                None)
    if read is None:
        raise ImageFileError(f'{path}: ' + _CONVERT.get(
            path.suffix.lower(), f'no image by its name; {KINDS} expected'))
    if path.exists() and not path.is_file():
        raise ImageFileError(f'{path}: no file')    # a pipe would never end
    if path.exists() and not path.stat().st_size:
        raise ImageFileError(f'{path}: empty')
    planes = _quiet(read(path))
    count = 0
    while True:
        try:
            plane = next(planes, None)
            if plane is None:
                break
            picture = Picture.of(plane)
        except (OSError, LimitError, ImportError, KindError) as error:
            what = getattr(error, 'strerror', None) or str(error)
            raise ImageFileError(f'{path}: {" ".join(what.split())}') from None
        except Exception as error:      # libraries raise of every kind on damaged files
            raise ImageFileError(f'{path}: damaged: {_told(error)}') from None
        count += 1
        yield picture
    if not count:
        raise ImageFileError(f'{path}: no image in it')


def _told(error: Exception) -> str:
    """Return what an error says; of one that is no plain ValueError with its kind."""
    said = error.args[0] if error.args else ''
    text = said.decode('utf-8', 'replace') if isinstance(said, bytes) else str(error)
    kind = '' if type(error) is ValueError else f'{type(error).__name__} '
    return ' '.join(f'{kind}{text}'.split())


def _quiet(planes: Iterator[Plane]) -> Iterator[Plane]:
    """Yield planes without what libraries warn of: what matters is raised."""
    while True:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            plane = next(planes, None)
        if plane is None:
            return
        yield plane
