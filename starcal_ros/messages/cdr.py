# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Many CDR messages at once: what all of them have in common.

A ROS 2 message is four bytes of encapsulation (the second tells little-endian, 1, from
big-endian, 0), then its fields in order, each aligned to its own size counted from there; those of
the suite begin with std_msgs/Header. The types have a module each: `cdr_imu`, `cdr_pointcloud`,
`cdr_image`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.arrays import Ints, Mask
from starcal_ros.files.foreign import clean

ByteOrder = Literal['<', '>']

ENCAPSULATION = 4
HEADER = np.dtype([('sec', 'i4'), ('nanosec', 'u4'), ('frame_id_length', 'u4')])


class RecordError(ValueError):
    """A recording or a message that cannot be read or written; one line that says why."""

    def __init__(self, text: str) -> None:
        super().__init__(clean(text))


@dataclass(frozen=True)
class Messages:
    """CDR messages in one buffer.

    Attributes
    ----------
    data : (n_bytes,) uint8 array
        The buffer; between the messages it may hold anything.
    start, size : (n,) int64 array
        Where each message starts in it, and its length [bytes].
    """

    data: NDArray[np.uint8]
    start: Ints
    size: Ints

    def __len__(self) -> int:
        return len(self.start)

    def take(self, rows: Mask) -> Messages:
        """Return some of them."""
        return Messages(self.data, self.start[rows], self.size[rows])

    @classmethod
    def join(cls, messages: Sequence[bytes]) -> Messages:
        """Lay single messages end to end."""
        size = np.array([len(message) for message in messages], np.int64)
        return cls(np.frombuffer(b''.join(messages), np.uint8), np.cumsum(size) - size, size)


def gather(data: NDArray[np.uint8], position: Ints, dtype: np.dtype[np.void],
           ) -> NDArray[np.void]:
    """Read a packed structure at each of many byte positions, aligned or not, (n,) of dtype."""
    if not position.size:
        return np.empty(0, dtype)
    windows: NDArray[np.void] = np.ndarray(
        (len(data) - dtype.itemsize + 1,), f'V{dtype.itemsize}', data, strides=(1,))
    return windows[position].view(dtype)


def by_byte_order(messages: Messages) -> Iterator[tuple[Ints, ByteOrder]]:
    """Split messages by the byte order of their encapsulation.

    Yields
    ------
    rows : (m,) int64 array
        The messages of one byte order, never none.
    order : ByteOrder
        ``'<'`` little-endian or ``'>'`` big-endian.

    Raises
    ------
    RecordError
        If a message has no encapsulation, or not that of plain CDR.
    """
    require(messages.size - ENCAPSULATION, 0, 'a CDR message')
    kind = gather(messages.data, messages.start, np.dtype([('kind', '>u2')]))['kind']
    if kind.max(initial=0) > 1:
        raise RecordError(f'the encapsulation 0x{kind.max():04x} is not plain CDR '
                          '(0x0000 big-endian, 0x0001 little-endian)')
    orders: tuple[ByteOrder, ByteOrder] = ('>', '<')
    for value, order in enumerate(orders):
        rows = np.flatnonzero(kind == value)
        if rows.size:
            yield rows, order


def require(size: Ints, needed: int | Ints, what: str) -> None:
    """Raise RecordError where a message is shorter than its content, encapsulation apart."""
    short = np.flatnonzero(size < needed)
    if short.size:
        has, needs = (np.broadcast_to(n, size.shape)[short[0]] + ENCAPSULATION
                      for n in (size, needed))
        raise RecordError(f'a message of {has} bytes is cut short: {what} needs {needs}')


def header_stamp_ns(header: NDArray[np.void]) -> Ints:
    """Return the stamps of std_msgs/Header, (n,) ns since the epoch."""
    stamp_ns: Ints = header['sec'] * np.int64(10**9) + header['nanosec']
    return stamp_ns


def stamps_ns(messages: Messages) -> Ints:
    """Return the stamps of messages that begin with std_msgs/Header, (n,) ns since the epoch.

    Raises
    ------
    RecordError
        If a message has no header.
    """
    found = np.empty(len(messages), np.int64)
    for rows, order in by_byte_order(messages):
        require(messages.size[rows] - ENCAPSULATION, HEADER.itemsize, 'a header')
        found[rows] = header_stamp_ns(gather(
            messages.data, messages.start[rows] + ENCAPSULATION, HEADER.newbyteorder(order)))
    return found


def frame_id(message: bytes) -> str | None:
    """Return the frame_id in the header of one message, None where there is none to be read."""
    begin = ENCAPSULATION + HEADER.itemsize
    if len(message) < begin:
        return None
    header = HEADER.newbyteorder('<' if message[1] & 1 else '>')
    length = int(np.frombuffer(message, header, 1, ENCAPSULATION)['frame_id_length'][0])
    if not 0 < length <= len(message) - begin:
        return None
    return clean(message[begin:begin + length - 1].decode(errors='replace'))
