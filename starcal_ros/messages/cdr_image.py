# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images to and from CDR: sensor_msgs/Image.

::

    Image   sec i4 | nanosec u4 | frame_id | height u4 | width u4 | encoding |
            is_bigendian u1 | step u4 | data: length u4, bytes

Of each row of `step` bytes the first `width` pixels count, whatever follows them. Colour becomes
luminance (ITU-R BT.601), saturated where any of its channels is.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros.files.limits import IMAGE, LimitError
from starcal_ros.imaging.mosaic import PATTERNS
from starcal_ros.imaging.pixels import grey
from starcal_ros.messages.cdr import ENCAPSULATION, RecordError

IMAGE_TYPE = 'sensor_msgs/msg/Image'
COMPRESSED_TYPE = 'sensor_msgs/msg/CompressedImage'

# Type of a channel, number of channels, which of them are red, green and blue.
_ENCODINGS = {
    **{name: ('u1', 1, (0,)) for name in ('mono8', '8UC1')},
    **{name: ('u2', 1, (0,)) for name in ('mono16', '16UC1')},
    'rgb8': ('u1', 3, (0, 1, 2)), 'bgr8': ('u1', 3, (2, 1, 0)),
    'rgba8': ('u1', 4, (0, 1, 2)), 'bgra8': ('u1', 4, (2, 1, 0)),
    '32FC1': ('f4', 1, (0,)),
    **{f'bayer_{pattern.lower()}{bits}': (kind, 1, (0,)) for pattern in PATTERNS
       for bits, kind in (('8', 'u1'), ('16', 'u2'))},
    'rgb16': ('u2', 3, (0, 1, 2)), 'bgr16': ('u2', 3, (2, 1, 0)),
}


class ImageMessageError(RecordError):
    """An image that can not be used.

    Attributes
    ----------
    kind : str
        What is wrong, without the numbers of this one image.
    """

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(f'{kind}: {detail}')
        self.kind = kind


class ImageMessage(NamedTuple):
    """One image.

    Attributes
    ----------
    stamp_ns : int
        Middle of the exposure, UTC since the Unix epoch.
    frame_id : str
    pixels : (height, width) array
        uint8, uint16 or float32 counts, top row first.
    pattern : str
        Of the colour filters before them, as `mosaic` has it; empty where there are none.
    """

    stamp_ns: int
    frame_id: str
    pixels: NDArray[np.generic]
    pattern: str = ''


def encode_image(stamp_ns: int, pixels: NDArray[np.uint16],
                 frame_id: str = 'star_tracker_optical') -> bytes:
    """Encode an image (height, width) as a little-endian mono16 sensor_msgs/Image."""
    height, width = pixels.shape
    head = b'\0\1\0\0' + struct.pack('<iI', *divmod(stamp_ns, 10**9)) + _string(frame_id)
    # The byte is_bigendian follows the encoding at once; the step is aligned again.
    head = _aligned(head) + struct.pack('<II', height, width) + _string('mono16') + b'\0'
    data = pixels.astype('<u2').tobytes()
    return b''.join((_aligned(head), struct.pack('<II', 2 * width, len(data)), data))


def decode_image(message: bytes) -> ImageMessage:
    """Decode sensor_msgs/Image.

    Raises
    ------
    ImageMessageError
        If the message is cut short or not plain CDR, its encoding is not one of the known, or
        `width`, `step` and the length of `data` contradict each other.
    """
    stamp_ns, frame_id, height, width, encoding, is_bigendian, step, data = _fields(message)
    if encoding not in _ENCODINGS:
        raise ImageMessageError('unsupported encoding', f'{encoding[:40]!r}, supported are '
                                + ', '.join(_ENCODINGS))
    kind, channels, colours = _ENCODINGS[encoding]
    pixel = np.dtype(('>' if is_bigendian else '<') + kind)
    row = width * channels * pixel.itemsize
    if not height or not width:
        raise ImageMessageError('empty image', f'{width} x {height} pixels')
    if step < row:
        raise ImageMessageError('wrong step', f'{step} bytes a row, {width} pixels {encoding} '
                                f'need {row}')
    if len(data) < (height - 1) * step + row:
        raise ImageMessageError('wrong length of data', f'{len(data)} bytes, {height} rows of '
                                f'{step} bytes need {height * step}')
    try:
        IMAGE.check(width * height, 'an image')
    except LimitError as error:
        raise ImageMessageError('image too large', str(error)) from None
    # Strides, not a reshape: the padding of the last row may be missing.
    pixels: NDArray[np.generic] = np.ndarray(
        (height, width, channels), pixel, data, strides=(step, channels * pixel.itemsize,
                                                         pixel.itemsize))
    native = pixel.newbyteorder('=')
    if channels == 1:
        pattern = encoding[6:10].upper() if encoding.startswith('bayer_') else ''
        return ImageMessage(stamp_ns, frame_id, pixels[..., 0].astype(native), pattern)
    luminance = grey(pixels[..., colours].astype(np.float32), np.iinfo(native).max)
    return ImageMessage(stamp_ns, frame_id, np.rint(luminance).astype(native))


def _fields(message: bytes) -> tuple[int, str, int, int, str, int, int, memoryview]:
    """Return the fields of a message as they stand, `data` as a view."""
    try:
        encapsulation, order = message[:2], '<' if message[1] else '>'
        if encapsulation not in (b'\0\0', b'\0\1'):
            raise ImageMessageError('damaged message', 'the encapsulation '
                                    f'0x{encapsulation.hex()} is not plain CDR')
        sec, nanosec, length = struct.unpack_from(f'{order}iII', message, 4)
        frame_id, at = _text(message, 16, length)
        height, width, length = struct.unpack_from(f'{order}III', message, at := at + 3 & ~3)
        encoding, at = _text(message, at + 12, length)
        is_bigendian = message[at]
        step, length = struct.unpack_from(f'{order}II', message, at := at + 4 & ~3)
    except (struct.error, IndexError):
        raise ImageMessageError('damaged message', f'a message of {len(message)} bytes is cut '
                                f'short before its pixels, {IMAGE_TYPE}') from None
    data = memoryview(message)[at + 8:at + 8 + length]
    if len(data) < length:
        raise ImageMessageError('damaged message', f'{len(data)} bytes of pixels, {length} are '
                                'announced')
    return (sec * 10**9 + nanosec, frame_id, height, width, encoding, is_bigendian, step, data)


def _text(message: bytes, at: int, length: int) -> tuple[str, int]:
    """Return a string of a length with its NUL, and where it ends."""
    return message[at:at + max(length - 1, 0)].decode(errors='replace'), at + length


def _string(text: str) -> bytes:
    content = text.encode() + b'\0'
    return struct.pack('<I', len(content)) + content


def _aligned(head: bytes) -> bytes:
    """Pad what comes before a number of four bytes."""
    return head + bytes(-(len(head) - ENCAPSULATION) % 4)
