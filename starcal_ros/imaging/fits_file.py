# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images of FITS files, through astropy: packed or not, several units, cubes, mosaics.

FITS counts rows from the bottom unless its header has a ROWORDER of TOP-DOWN. Three planes with
the same stars are colours, any others are so many images. Of several units the first that can be
a sky is taken.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
import gzip
from io import BytesIO
from pathlib import Path
import subprocess
import sys
from tempfile import NamedTemporaryFile
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, median_filter, uniform_filter

from starcal_ros.files.limits import IMAGE
from starcal_ros.imaging import exposure_time, fits_scan, focal_hint, mosaic
from starcal_ros.imaging.picture import KindError, Plane
from starcal_ros.imaging.pixels import Scale

SUFFIXES = tuple(kind + packed for kind in ('.fits', '.fit', '.fts')
                 for packed in ('', '.fz', '.gz', '.bz2'))

_PACKED: Mapping[bytes, Callable[[Path, str], Any]] = {
    b'\x1f\x8b': gzip.open, b'BZ': bz2.open}     # by their first two bytes
_BYTES_A_PIXEL = 8 * fits_scan.COLOURS
_NO_SKY = ('MASK', 'DQ', 'BPM', 'ERR', 'VAR', 'WEIGHT', 'WHT', 'UNCERT', 'FLAG', 'SEG')
"""Beginnings of the names of units that hold something about the pixels of another one."""
_LEAST_SIDE, _LEAST_LEVELS = 16, 5
_STAR_SIGMAS, _STAR_PIXELS, _MOST_PIXELS = 10.0, 4, 10_000_000
_LOOKED_AT, _WIDE_PX, _NEAR_PX = 1024, 15, 5        # of planes that may be colours
_BRIGHT_PART, _SAME_PART = 0.005, 0.5           # by chance 0.12 are the same
_UNPACK_S = 120.0
_UNPACK = """
import sys
path, index, *sys.path[:] = sys.argv[1:]
import numpy
from astropy.io import fits
with fits.open(path) as units:
    numpy.save(sys.stdout.buffer, numpy.array(units[int(index)].data))
"""


class _Unit(NamedTuple):
    """Header and pixels of a unit, and what is to be said of it."""

    header: Mapping[str, Any]
    pixels: NDArray[Any]
    note: str


def read(path: Path) -> Iterator[Plane]:
    """Yield the images of a file.

    Raises
    ------
    ValueError, OSError
        Where it has none, or more than is allowed; astropy raises of other kinds on damaged files.
    """
    with _plain(path) as plain:
        fits_scan.check(plain)
        header, pixels, note = _sky(plain)
    scale = Scale.of(pixels.dtype)
    scale = Scale(float(header.get('SATURATE', scale.top)), scale.step)
    top_down = str(header.get('ROWORDER', '')).strip().upper() == 'TOP-DOWN'
    taken, pattern = exposure_time.of_fits(header), _pattern(header)
    focal_px = focal_hint.of_fits(header, pixels.shape[-1])
    for plane in _planes(pixels):
        said = [note, 'its three planes show the same stars: they are colours'][:plane.ndim - 1]
        yield Plane(plane if top_down else plane[::-1], scale, taken, pattern,
                    ', '.join(filter(None, said)), focal_px)


def _planes(pixels: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Yield the images of an array: planes of colour together, all others one by one."""
    if pixels.ndim > 2 and len(pixels) == 1:
        yield from _planes(pixels[0])
    elif pixels.ndim == 3 and len(pixels) == 3 and _shows_one_sky(pixels):
        yield np.moveaxis(pixels, 0, -1)
    elif pixels.ndim > 3 or pixels.ndim == 3 and pixels.shape[2] > 4:
        for part in pixels:
            yield from _planes(part)
    else:
        yield pixels


def _shows_one_sky(planes: NDArray[Any]) -> bool:
    """Tell colours (3, height, width) from exposures: what is bright in one is so in the others.

    What is wider than a star, such as a vignette, and single hot pixels are in exposures, too.
    """
    top, left = (max(0, (size - _LOOKED_AT) // 2) for size in planes.shape[1:])
    part = np.nan_to_num(planes[:, top:top + _LOOKED_AT, left:left + _LOOKED_AT].astype(float))
    bright = []
    for plane in part:
        point = median_filter(plane, 3)
        point -= uniform_filter(point, _WIDE_PX)
        bright.append(point > np.quantile(point, 1.0 - _BRIGHT_PART))
    near = [maximum_filter(each, _NEAR_PX) for each in bright]
    return all(np.count_nonzero(bright[1] & each) >= _SAME_PART * np.count_nonzero(bright[1])
               for each in (near[0], near[2]))


def _sky(path: Path) -> _Unit:
    """Return the first unit that can be a sky, or the first with any pixels."""
    from astropy.io import fits  # here, because it takes a quarter of a second
    first: _Unit | None = None
    likely: _Unit | None = None
    with fits.open(path) as units:
        primary = units[0].header
        for index, unit in enumerate(units):
            if isinstance(unit, fits.CompImageHDU):
                with fits.open(path, disable_image_compression=True) as tables:
                    fits_scan.check_tiles(tables[index])
                pixels = _unpack(path, index)
            elif unit.is_image and unit.data is not None:
                pixels = np.array(unit.data)
            else:
                continue
            header = unit.header
            if index and header.get('INHERIT', True):       # time and camera stand there
                header = primary.copy()
                header.update(unit.header)
            note = f'unit {index} of {len(units)} is taken' if first else ''
            first = first or _Unit(header, pixels, '')
            if not str(unit.name).upper().startswith(_NO_SKY) and _varies(pixels):
                likely = likely or _Unit(header, pixels, note)
                if _shows_stars(pixels):
                    return _Unit(header, pixels, note)
    found = likely or first
    if found is None:
        raise KindError('no image in it')
    return found


def _varies(pixels: NDArray[Any]) -> bool:
    """Tell an image from a mask, or from a thumbnail."""
    if pixels.ndim < 2 or min(pixels.shape[-2:]) < _LEAST_SIDE:
        return False
    return len(np.unique(pixels.ravel()[::max(1, pixels.size // 100_000)])) >= _LEAST_LEVELS


def _shows_stars(pixels: NDArray[Any]) -> bool:
    """Tell a sky from a flat field or a map of weights: it has bright pixels, and no dark ones."""
    known = pixels[np.isfinite(pixels)][:_MOST_PIXELS].astype(float)
    if not len(known):
        return False
    low, level = np.percentile(known, [16.0, 50.0])
    far = _STAR_SIGMAS * (level - low)
    bright, dark = (int(np.count_nonzero(off > far)) for off in (known - level, level - known))
    return bright >= _STAR_PIXELS and bright > _STAR_PIXELS * dark


def _pattern(header: Mapping[str, Any]) -> str:
    """Return the colours of a mosaic."""
    for key in ('BAYERPAT', 'COLORTYP', 'CFA-PAT'):
        pattern = str(header.get(key, '')).strip().upper()
        if pattern in mosaic.PATTERNS:
            return pattern
    return ''


@contextmanager
def _plain(path: Path) -> Iterator[Path]:
    """Give a file that is packed as a whole unpacked, up to the largest image."""
    with path.open('rb') as stream:
        unpack = _PACKED.get(stream.read(2))
    if unpack is None:
        yield path
        return
    with NamedTemporaryFile(suffix='.fits') as plain:
        with unpack(path, 'rb') as packed:
            while block := packed.read(1 << 20):
                IMAGE.check((plain.tell() + len(block)) // _BYTES_A_PIXEL, 'an image, unpacked,')
                plain.write(block)
        plain.flush()
        yield Path(plain.name)


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
