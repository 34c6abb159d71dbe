# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a FITS file announces, looked at before anything is read for it.

A FITS file is a sequence of units: a header in blocks of 2880 bytes, each of 36 cards of 80
characters, then data, whose length the header gives. A header is believed only as far as the file
is long and the limits allow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod
from pathlib import Path
from typing import Any, BinaryIO
import zlib

from starcal_ros.files.limits import IMAGE

_BLOCK, _CARD = 2880, 80
_AXES = 9               # more than an image of any camera has; the standard allows 999
_HEADER_BLOCKS = 1000
_GZIP = 31              # zlib's word for data with a head of gzip

COLOURS = 4
"""Images of the largest size that may lie on each other in a unit."""

Header = dict[str, str]
"""The values of a header that are wanted, as they stand, by keyword."""


def check(path: Path) -> None:
    """Look at the headers of a file.

    Raises
    ------
    ValueError
        Where it is no FITS file, or a header announces what can not be.
    """
    size = path.stat().st_size
    with path.open('rb') as stream:
        if stream.read(6) != b'SIMPLE':
            raise ValueError('not FITS: it does not begin with SIMPLE')
        position = 0
        while position + _BLOCK <= size:
            stream.seek(position)
            header = _header(stream)
            if header is None:
                return          # what follows the last unit is not FITS, and is not read
            axes: Sequence[int] = list(
                _axes(header, 'ZNAXIS' if header.get('ZIMAGE') == 'T' else 'NAXIS'))
            if axes and prod(axes) and ('TABLE' not in header.get('XTENSION', '')
                                        or header.get('ZIMAGE') == 'T'):
                IMAGE.check(prod(axes[:2]), 'an image')
                IMAGE.check(prod(axes) // COLOURS, 'an image')
            position = stream.tell() + _data_bytes(header)


def check_tiles(table: Any) -> None:
    """Look at the tiles of a compressed image that gzip has packed: how large they become.

    Parameters
    ----------
    table : BinTableHDU
        What astropy reads without unpacking the image.

    Raises
    ------
    ValueError
        Where a tile is damaged, or holds more than its pixels.
    """
    header = table.header
    sizes = [header[f'ZNAXIS{axis}'] for axis in range(1, header['ZNAXIS'] + 1)]
    tiles = [min(header.get(f'ZTILE{axis}', size if axis == 1 else 1), size)
             for axis, size in enumerate(sizes, start=1)]
    count = prod(-(-size // tile) for size, tile in zip(sizes, tiles))
    for name in table.columns.names:
        if name == 'GZIP_COMPRESSED_DATA' or (
                name == 'COMPRESSED_DATA' and str(header['ZCMPTYPE']).startswith('GZIP')):
            packed = table.data[name]
            for row in range(min(count, len(packed))):
                if len(packed[row]):
                    _check_tile(packed[row].tobytes(), prod(tiles))


def _check_tile(data: bytes, pixels: int) -> None:
    stream = zlib.decompressobj(_GZIP)
    try:
        stream.decompress(data, 8 * pixels + 1)
    except zlib.error as error:
        raise ValueError(f'damaged tile: {error}') from None
    if stream.unconsumed_tail or not stream.eof:
        raise ValueError(f'damaged tile: more than its {pixels} pixels, or cut short')


def _header(stream: BinaryIO) -> Header | None:
    """Read a header; None where there is none."""
    header: Header = {}
    for number in range(_HEADER_BLOCKS):
        block = stream.read(_BLOCK)
        if len(block) < _BLOCK:
            return None
        for start in range(0, _BLOCK, _CARD):
            card = block[start:start + _CARD].decode('latin-1')
            keyword = card[:8].rstrip()
            if number == start == 0 and keyword not in ('SIMPLE', 'XTENSION'):
                return None
            if keyword == 'END':
                return header
            if card[8:10] == '= ':
                header.setdefault(keyword, card[10:].split('/')[0].strip())
    raise ValueError(f'a header of more than {_HEADER_BLOCKS} blocks')


def _axes(header: Header, name: str) -> Iterator[int]:
    count = _number(header, name, 0)
    if count > _AXES:
        raise ValueError(f'{name} = {count}, at most {_AXES} are read')
    for axis in range(1, count + 1):
        yield _number(header, f'{name}{axis}', 0)


def _data_bytes(header: Header) -> int:
    axes: Sequence[int] = list(_axes(header, 'NAXIS'))
    if not axes:
        return 0
    if axes[0] == 0 and header.get('GROUPS') == 'T':
        axes = axes[1:]
    n_bytes = (abs(_signed(header, 'BITPIX', 8)) // 8 * _number(header, 'GCOUNT', 1)
               * (_number(header, 'PCOUNT', 0) + prod(axes)))
    return -(-n_bytes // _BLOCK) * _BLOCK


def _number(header: Header, keyword: str, default: int) -> int:
    number = _signed(header, keyword, default)
    if number < 0:
        raise ValueError(f'{keyword} = {number}, needs 0 or more')
    return number


def _signed(header: Header, keyword: str, default: int) -> int:
    text = header.get(keyword, str(default))
    if len(text) > 20:
        raise ValueError(f'{keyword} = {text[:20]}..., needs a number of pixels or bytes')
    try:
        return int(text)
    except ValueError:
        raise ValueError(f'{keyword} = {text}, needs an integer') from None
