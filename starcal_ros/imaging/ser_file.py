# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Films of astronomical cameras in SER: a head, frame after frame, and the times of the frames.

Source: H. Wellmann, *SER format description version 3* (2014). Its flag of the byte order was
written both ways by the first programs; the right order is the one that makes neighbours alike.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timedelta, timezone
from pathlib import Path
import struct

import numpy as np
from numpy.typing import NDArray

from starcal_ros.files.limits import IMAGE
from starcal_ros.imaging.picture import KindError, Plane
from starcal_ros.imaging.pixels import Scale

_MAGIC = b'LUCAM-RECORDER'
_HEAD = struct.Struct('<14s7i120s2q')
_PATTERNS = {8: 'RGGB', 9: 'GRBG', 10: 'GBRG', 11: 'BGGR'}
_COLOURS = {100: (0, 1, 2), 101: (2, 1, 0)}
_TICKS_S = 10**7        # from the year 1 on


def read(path: Path) -> Iterator[Plane]:
    """Yield the frames of a film.

    Raises
    ------
    ValueError
        Where it is none, or ends within the first frame.
    """
    with path.open('rb') as stream:
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size or not head.startswith(_MAGIC):
            raise KindError('no SER: it does not begin with LUCAM-RECORDER')
        _, _, colour, _, width, height, depth, count, *_ = _HEAD.unpack(head)
        if min(width, height, count) < 1 or not 1 <= depth <= 16:
            raise ValueError(f'{count} frames of {width} x {height} pixels of {depth} bits')
        IMAGE.check(width * height, 'an image')
        channels = 3 if colour in _COLOURS else 1
        kind = np.dtype('u1' if depth <= 8 else '<u2')
        size = width * height * channels * kind.itemsize
        whole, note = (path.stat().st_size - _HEAD.size) // size, ''
        if not whole:
            raise ValueError(f'cut short: {count} frames of {size} bytes are announced')
        if whole < count:
            count, note = whole, f'cut short: the first {whole} of {count} frames are there'
        stream.seek(_HEAD.size + count * size)
        times = np.frombuffer(b'' if note else stream.read(8 * count), '<i8')
        for k in range(count):
            stream.seek(_HEAD.size + k * size)
            pixels = np.frombuffer(stream.read(size), kind).reshape(height, width, channels)
            pixels = _in_order(pixels)
            full = 2.0**depth - 1.0
            scale = Scale(full if pixels.max() <= full else float(np.iinfo(kind).max), 1.0)
            yield Plane(pixels[..., _COLOURS[colour]] if channels == 3 else pixels[..., 0], scale,
                        _time(times, k), _PATTERNS.get(colour, ''), note)


def _in_order(pixels: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return pixels of two bytes in the order in which those beside each other differ less."""
    other = pixels.view(pixels.dtype.newbyteorder())
    rough = [float(np.abs(np.diff(value[::5].astype(float), axis=1)).mean())
             for value in (pixels, other)]
    return (other if rough[1] < rough[0] else pixels).astype(pixels.dtype)


def _time(times: NDArray[np.int64], k: int) -> datetime | None:
    if k >= len(times) or times[k] <= 0:
        return None
    try:
        return datetime(1, 1, 1, tzinfo=timezone.utc) + timedelta(
            seconds=float(times[k] // _TICKS_S),
            microseconds=float(times[k] % _TICKS_S) / 10.0)
    except OverflowError:
        return None
