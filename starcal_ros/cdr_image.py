# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Grey images from CDR: sensor_msgs/Image, one after the other.

::

    Image   sec i4 | nanosec u4 | frame_id | height u4 | width u4 | encoding: length u4, bytes |
            is_bigendian u1 | step u4 | data: length u4, bytes

``is_bigendian`` is that of the pixels; `step` the bytes of a row, which may be padded.
"""

from __future__ import annotations

from collections.abc import Iterator
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros.cdr import (ENCAPSULATION, HEADER, ByteOrder, Messages, RecordError,
                             by_byte_order, header_stamp_ns)

IMAGE_TYPE = 'sensor_msgs/msg/Image'

_GREY = {'mono8': 'u1', '8UC1': 'u1', 'mono16': 'u2', '16UC1': 'u2'}


class StampedImage(NamedTuple):
    """An image.

    Attributes
    ----------
    stamp_ns : int
        Middle of the exposure, UTC since the Unix epoch.
    counts : (height, width) uint8 or uint16 array
        Top row first; a view of the message.
    """

    stamp_ns: int
    counts: NDArray[np.generic]


def decode_images(messages: Messages) -> Iterator[StampedImage]:
    """Decode sensor_msgs/Image, one a message, in the same order.

    Raises
    ------
    RecordError
        If a message is too short for its own content, is not plain CDR, or is not grey.
    """
    byte_order: list[ByteOrder] = ['<'] * len(messages)
    for rows, order in by_byte_order(messages):
        for row in rows.tolist():
            byte_order[row] = order
    for start, size, order in zip(messages.start.tolist(), messages.size.tolist(), byte_order):
        yield _decode(messages.data[start + ENCAPSULATION:start + size], order)


def _decode(data: NDArray[np.uint8], order: ByteOrder) -> StampedImage:
    message = data.tobytes()
    try:
        header = np.frombuffer(message[:HEADER.itemsize], HEADER.newbyteorder(order))
        at = HEADER.itemsize + int(header['frame_id_length'][0]) + 3 & ~3
        height, width, length = struct.unpack_from(f'{order}III', message, at)
        at += 12
        encoding = bytes(message[at:at + length]).rstrip(b'\0').decode(errors='replace')
        at += length
        (big,) = struct.unpack_from('B', message, at)
        at = at + 1 + 3 & ~3
        step, length = struct.unpack_from(f'{order}II', message, at)
    except (struct.error, ValueError, IndexError):
        raise RecordError(f'a message of {len(data) + ENCAPSULATION} bytes is cut short: '
                          f'{IMAGE_TYPE} needs more') from None
    if encoding not in _GREY:
        raise RecordError(f'a {IMAGE_TYPE} of encoding {encoding!r}; needs {", ".join(_GREY)}')
    pixel = np.dtype(('>' if big else '<') + _GREY[encoding])
    pixels = data[at + 8:at + 8 + length]
    row, needed = width * pixel.itemsize, height * step
    if step < row or len(pixels) < needed or not row or not height:
        raise RecordError(f'{height} rows of {width} pixels {encoding}, step {step}, do not fit '
                          f'into {len(pixels)} bytes of a {IMAGE_TYPE}')
    rows = np.ascontiguousarray(pixels[:needed].reshape(height, step)[:, :row])
    return StampedImage(int(header_stamp_ns(header)[0]), rows.view(pixel))
