# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images that Pillow reads, and what it would cut: colours of 16 bits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from io import BytesIO
from pathlib import Path
import sys
from typing import Any

from PIL import Image, ImageFile, UnidentifiedImageError
import numpy as np
from numpy.typing import NDArray

from starcal_ros.files.limits import IMAGE
from starcal_ros.imaging import exposure_time, focal_hint
from starcal_ros.imaging.picture import KindError, Plane
from starcal_ros.imaging.pixels import Scale

SUFFIXES = ('.png', '.tif', '.tiff', '.jpg', '.jpeg', '.bmp', '.pgm', '.ppm', '.pnm', '.webp',
            '.avif', '.heic', '.heif')

_CODED = ('P', 'CMYK', 'YCbCr', 'LAB', 'HSV')
_FOREIGN = '16B' if sys.byteorder == 'little' else '16L'
_OTHER_BYTE = {';16B': ';16L', ';16L': ';16B', ';16N': f';{_FOREIGN}'}
"""How Pillow has to be told the order of bytes to get, for the upper of two, the lower one."""
_HEIF = b'heic', b'heix', b'heim', b'heis', b'hevc', b'hevx', b'mif1', b'msf1'
"""What such a file says of itself after its first eight bytes, ....ftyp."""
_TIFF = b'II*\0', b'MM\0*', b'II+\0', b'MM\0+'
"""First bytes of such a file, of either order of bytes, of any size."""
_BITS, _INK, _LAYOUT = 258, 262, 284        # tags of TIFF
_WHITE_IS_0, _PLANAR = 0, 2
_PLANES = 'RGBA'


def read(path: Path) -> Iterator[Plane]:
    """Yield the image of a file; of TIFF every page of the size of the first.

    Raises
    ------
    ImportError, ValueError, OSError
        Where it can not be read; Pillow raises of other kinds on damaged files.
    """
    with path.open('rb') as stream:
        head = stream.read(12)
    if path.suffix.lower() in ('.heic', '.heif') or (       # or whatever it is called
            head[4:8] == b'ftyp' and head[8:] in _HEIF):
        _learn_heif()
    with _opened(path, head) as picture:
        IMAGE.check(picture.width * picture.height, 'an image')
        size, pages = picture.size, getattr(picture, 'n_frames', 1)
        for page in range(pages if picture.format == 'TIFF' else 1):
            picture.seek(page)
            if picture.size != size:
                continue                    # a preview
            with _whole_ones():
                pixels, scale = _pixels(path, picture, page)    # before EXIF, which loads PNG
            exif = picture.getexif()
            yield Plane(pixels, scale, exposure_time.of_exif(exif),
                        focal_px=focal_hint.of_exif(exif, *size))


def _opened(path: Path, head: bytes) -> Image.Image:
    try:
        return Image.open(path)
    except UnidentifiedImageError:
        if head[:4] in _TIFF:
            raise KindError('TIFF of a kind that is not read, such as floats of three colours, or '
                            'of 16 or 64 bits: save it as FITS or 16-bit TIFF') from None
        raise KindError('cannot identify image: what it holds is none, or of a kind that is not '
                        'read: save it as PNG or 16-bit TIFF') from None


def decoded(data: bytes, formats: tuple[str, ...]) -> NDArray[Any]:
    """Return the pixels of an image in memory, (height, width) or with colours behind.

    Parameters
    ----------
    data : bytes
        As a file has them.
    formats : tuple of str
        Those that are allowed, as Pillow calls them.

    Raises
    ------
    ValueError, OSError
        Where it can not be read; Pillow raises of other kinds on damaged files.
    """
    try:
        picture = Image.open(BytesIO(data), formats=formats)
    except UnidentifiedImageError:      # which would name a place in memory
        raise KindError('cannot identify image') from None
    with picture:
        IMAGE.check(picture.width * picture.height, 'an image')
        with _whole_ones():
            return _pixels(BytesIO(data), picture, 0)[0]


@contextmanager
def _whole_ones() -> Iterator[None]:
    """Have Pillow refuse images that are cut short, whatever others in this process told it.

    WeasyPrint, for one, has it fill them up with grey, for all the process.
    """
    told = ImageFile.LOAD_TRUNCATED_IMAGES
    ImageFile.LOAD_TRUNCATED_IMAGES = False
    try:
        yield
    finally:
        ImageFile.LOAD_TRUNCATED_IMAGES = told


def _pixels(path: Path | BytesIO, picture: Image.Image, page: int) -> tuple[NDArray[Any], Scale]:
    raw = _raw_mode(picture)
    if isinstance(path, Path) and picture.format == 'PPM' and picture.mode == 'RGB' and (
            _tiles(picture)[0][0] == 'ppm'):
        return _wide_ppm(path, picture)
    tags = getattr(picture, 'tag_v2', {})       # of TIFF
    if tags.get(_LAYOUT) == _PLANAR and max(tags[_BITS]) > 8:
        return _planar(path, picture, tags)
    if raw.startswith('LA;16'):
        raise KindError('16 bits of grey with alpha: save it without alpha')
    if picture.mode in ('RGB', 'RGBA') and raw[-4:] in _OTHER_BYTE:
        high = np.asarray(picture)[..., :3].astype(np.uint16)
        with Image.open(path) as again:
            again.seek(page)
            setattr(again, 'tile', [tile._replace(args=_swapped(tile.args))
                                    for tile in _tiles(again)])
            low = np.asarray(again)[..., :3]
        return high << 8 | low, Scale(65535.0, 1.0)
    pixels = np.asarray(picture.convert('RGB') if picture.mode in _CODED else picture)
    if picture.mode == 'I':                 # Pillow reads 16 bits of some formats into 32
        return pixels, Scale(65535.0 if pixels.max(initial=0) <= 65535 else np.inf, 1.0)
    if tags.get(_INK) == _WHITE_IS_0 and pixels.dtype == np.uint16:    # of 8 bits Pillow does it
        pixels = np.uint16(65535) - pixels
    return pixels, Scale.of(pixels.dtype)


def _planar(path: Path | BytesIO, picture: Image.Image, tags: Any) -> tuple[NDArray[Any], Scale]:
    """Read TIFF of 16 bits with one colour after the other, of which Pillow takes single bytes."""
    tiles, sizes = _tiles(picture), tags[_BITS]
    if not isinstance(path, Path) or {tile.codec_name for tile in tiles} != {'raw'} or (
            set(sizes) != {16}):
        raise KindError('more than 8 bits of one colour after the other, packed: save it with '
                        'the colours of a pixel together, or as FITS')
    kind = np.dtype('<u2' if tags.prefix == b'II' else '>u2')
    planes = np.zeros((len(sizes), picture.height, picture.width), np.uint16)
    with path.open('rb') as stream:
        for tile in tiles:
            left, top, right, bottom = tile.extents
            stream.seek(tile.offset)
            data = stream.read((right - left) * (bottom - top) * kind.itemsize)
            planes[_PLANES.index(tile.args[0]), top:bottom, left:right] = np.frombuffer(
                data, kind).reshape(bottom - top, right - left)
    return np.moveaxis(planes[:3], 0, -1), Scale(65535.0, 1.0)


def _raw_mode(picture: Image.Image) -> str:
    """Return how the file has its pixels, as Pillow calls it."""
    tiles = _tiles(picture)
    args = tiles[0].args if tiles else ''
    return str(args if isinstance(args, str) else args[0] if args else '')


def _tiles(picture: Image.Image) -> list[Any]:
    """Return what of the file is still to be decoded, and how."""
    return list(getattr(picture, 'tile', None) or ())


def _swapped(args: Any) -> Any:
    """Return the arguments of a decoder with the bytes of a colour in the other order."""
    raw = args if isinstance(args, str) else args[0]
    other = raw[:-4] + _OTHER_BYTE[raw[-4:]]
    return other if isinstance(args, str) else (other, *args[1:])


def _wide_ppm(path: Path, picture: Image.Image) -> tuple[NDArray[Any], Scale]:
    """Read colours of PPM, which Pillow scales to 8 bits where they do not fill these."""
    tile = _tiles(picture)[0]
    largest = int(tile.args[-1])
    kind = np.dtype('>u2' if largest > 255 else 'u1')
    with path.open('rb') as stream:
        if stream.read(2) != b'P6':
            raise KindError('PPM as text: save it as PNG or as binary PPM')
        stream.seek(tile.offset)
        data = stream.read(3 * picture.width * picture.height * kind.itemsize)
    return (np.frombuffer(data, kind).reshape(picture.height, picture.width, 3),
            Scale(float(largest), 1.0))


def _learn_heif() -> None:
    """Make Pillow read the pictures of phones."""
    try:
        import_module('pillow_heif').register_heif_opener()
    except ImportError:
        raise ImportError("to read HEIC, pillow-heif is needed: pip install 'starcal_ros[heif]' "
                          '(or convert it to TIFF or JPEG of full size)') from None
