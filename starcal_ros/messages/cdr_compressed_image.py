# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images from CDR: sensor_msgs/CompressedImage, as image_transport publishes it.

::

    CompressedImage   sec i4 | nanosec u4 | frame_id | format | data: length u4, bytes

The format is ``jpeg`` or ``png``, or has the encoding before and after as well, such as
``mono16; png compressed `` or ``bayer_rggb8; jpeg compressed bgr8``; what counts is what the data
are. Depth images (``compressedDepth``) are other data. PNG of 16 bits keeps them; JPEG has eight
and is lossy.
"""

from __future__ import annotations

from collections.abc import Callable
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros.files.limits import LimitError
from starcal_ros.imaging.pillow_file import decoded
from starcal_ros.imaging.pixels import grey
from starcal_ros.messages.cdr_image import (COMPRESSED_TYPE, ImageMessage, ImageMessageError,
                                            decode_image)

_FORMATS = ('JPEG', 'PNG')


def decode_compressed(message: bytes) -> ImageMessage:
    """Decode sensor_msgs/CompressedImage.

    Raises
    ------
    ImageMessageError
        If the message is cut short or not plain CDR, or its data are no whole JPEG or PNG.
    """
    stamp_ns, frame_id, described, data = _fields(message)
    if 'compressedDepth' in described:
        raise ImageMessageError('unsupported format', f'{described[:40]!r}, supported are jpeg '
                                'and png')
    try:
        pixels = decoded(data, _FORMATS)
    except LimitError as error:
        raise ImageMessageError('image too large', str(error)) from None
    except Exception as error:          # Pillow raises of every kind on damaged data
        raise ImageMessageError('damaged image', f'{len(data)} bytes of format '
                                f'{described[:40]!r} are no whole JPEG or PNG: {error}') from None
    encoding = described.partition(';')[0].strip()
    pattern = encoding[6:10].upper() if encoding.startswith('bayer_') and pixels.ndim == 2 else ''
    return ImageMessage(stamp_ns, frame_id, _luminance(pixels), pattern)


def decoder(message_type: str) -> Callable[[bytes], ImageMessage]:
    """Return what decodes images of a type, sensor_msgs/Image or CompressedImage."""
    return decode_compressed if message_type == COMPRESSED_TYPE else decode_image


def _luminance(pixels: NDArray[Any]) -> NDArray[np.generic]:
    """Return grey pixels of 8 or 16 bits."""
    if pixels.dtype not in (np.uint8, np.uint16):       # 16 bits in 32, or a bit in a bool
        pixels = pixels.astype(np.uint8 if pixels.dtype == np.bool_ else np.uint16)
    if pixels.ndim == 2:
        return pixels
    if pixels.shape[2] < 3:
        return pixels[..., 0]
    luminance = grey(pixels[..., :3].astype(np.float32), np.iinfo(pixels.dtype).max)
    return np.rint(luminance).astype(pixels.dtype)


def _fields(message: bytes) -> tuple[int, str, str, bytes]:
    """Return the fields of a message as they stand."""
    try:
        encapsulation, order = message[:2], '<' if message[1] else '>'
        if encapsulation not in (b'\0\0', b'\0\1'):
            raise ImageMessageError('damaged message', 'the encapsulation '
                                    f'0x{encapsulation.hex()} is not plain CDR')
        sec, nanosec = struct.unpack_from(f'{order}iI', message, 4)
        frame_id, at = _text(message, 12, order)
        described, at = _text(message, at + 3 & ~3, order)
        length, = struct.unpack_from(f'{order}I', message, at := at + 3 & ~3)
    except (struct.error, IndexError):
        raise ImageMessageError('damaged message', f'a message of {len(message)} bytes is cut '
                                f'short before its data, {COMPRESSED_TYPE}') from None
    data = bytes(message[at + 4:at + 4 + length])
    if len(data) < length:
        raise ImageMessageError('damaged message', f'{len(data)} bytes of data, {length} are '
                                'announced')
    return sec * 10**9 + nanosec, frame_id, described, data


def _text(message: bytes, at: int, order: str) -> tuple[str, int]:
    """Return the string at a place, and where it ends."""
    length, = struct.unpack_from(f'{order}I', message, at)
    if at + 4 + length > len(message):
        raise IndexError(at)
    return message[at + 4:at + 4 + max(length - 1, 0)].decode(errors='replace'), at + 4 + length
