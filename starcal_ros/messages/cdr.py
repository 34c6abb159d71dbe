# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gyro samples to and from CDR, many messages at once.

A ROS 2 message is four bytes of encapsulation (the second tells little-endian, 1, from
big-endian, 0), then its fields in order, each aligned to its own size counted from there::

    sensor_msgs/Imu     sec i4 | nanosec u4 | frame_id: length u4, bytes, NUL | pad to 8 |
                        37 float64: orientation 4, its covariance 9, angular velocity 3,
                        its covariance 9, linear acceleration 3, its covariance 9

The length of ``frame_id`` alone decides where the numbers stand, so that a few gathers read any
number of messages. :mod:`starcal_ros.messages.cdr_pointcloud` does the same for star frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from starcal_ros.measurements.samples import GyroSamples

ByteOrder = Literal['<', '>']

IMU_TYPE = 'sensor_msgs/msg/Imu'
ENCAPSULATION = 4
HEADER = np.dtype([('sec', 'i4'), ('nanosec', 'u4'), ('frame_id_length', 'u4')])

_IMU_NUMBERS = 37
_ORIENTATION_W, _ORIENTATION_COVARIANCE = 3, 4
_RATE, _RATE_COVARIANCE, _ACCELERATION_COVARIANCE = 13, 16, 28


class RecordError(ValueError):
    """A recording or a message that cannot be read or written; one line that says why."""


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
    start: NDArray[np.int64]
    size: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.start)

    @classmethod
    def join(cls, messages: Sequence[bytes]) -> Messages:
        """Lay single messages end to end."""
        size = np.array([len(message) for message in messages], np.int64)
        return cls(np.frombuffer(b''.join(messages), np.uint8), np.cumsum(size) - size, size)


def gather(data: NDArray[np.uint8], position: NDArray[np.int64], dtype: np.dtype[np.void],
           ) -> NDArray[np.void]:
    """Read a packed structure at each of many byte positions, aligned or not, (n,) of dtype."""
    if not position.size:
        return np.empty(0, dtype)
    windows: NDArray[np.void] = np.ndarray(
        (len(data) - dtype.itemsize + 1,), f'V{dtype.itemsize}', data, strides=(1,))
    return windows[position].view(dtype)


def by_byte_order(messages: Messages) -> Iterator[tuple[NDArray[np.int64], ByteOrder]]:
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


def require(size: NDArray[np.int64], needed: int | NDArray[np.int64], what: str) -> None:
    """Raise RecordError where a message is shorter than its content, encapsulation apart."""
    short = np.flatnonzero(size < needed)
    if short.size:
        has, needs = (np.broadcast_to(n, size.shape)[short[0]] + ENCAPSULATION
                      for n in (size, needed))
        raise RecordError(f'a message of {has} bytes is cut short: {what} needs {needs}')


def encode_imu(samples: GyroSamples, frame_id: str = 'gyro',
               angular_velocity_variance: float = 0.0) -> NDArray[np.uint8]:
    """Encode gyro samples as sensor_msgs/Imu without orientation and acceleration (REP-145).

    Parameters
    ----------
    samples : GyroSamples
        n samples; stamps in ns, rates in rad/s.
    frame_id : str
        Name of the gyro frame.
    angular_velocity_variance : float
        Variance of each axis, 0 where unknown [(rad/s)^2].

    Returns
    -------
    rows : (n, size) uint8 array
        One little-endian message a row.
    """
    name = frame_id.encode() + b'\0'
    padded = -(-(HEADER.itemsize + len(name)) // 8) * 8 - HEADER.itemsize
    dtype = np.dtype([('encapsulation', 'u1', ENCAPSULATION), ('sec', '<i4'), ('nanosec', '<u4'),
                      ('length', '<u4'), ('name', f'S{padded}'),
                      ('numbers', '<f8', _IMU_NUMBERS)])
    rows = np.zeros(len(samples), dtype)
    rows['encapsulation'][:, 1] = 1
    rows['sec'], rows['nanosec'] = np.divmod(samples.stamp_ns, 10**9)
    rows['length'], rows['name'] = len(name), name
    numbers = rows['numbers']
    numbers[:, _ORIENTATION_W] = 1.0
    numbers[:, [_ORIENTATION_COVARIANCE, _ACCELERATION_COVARIANCE]] = -1.0
    numbers[:, _RATE:_RATE + 3] = samples.rate
    numbers[:, _RATE_COVARIANCE:_RATE_COVARIANCE + 9:4] = angular_velocity_variance
    return rows.view(np.uint8).reshape(len(samples), dtype.itemsize)


def decode_imu(messages: Messages) -> GyroSamples:
    """Decode sensor_msgs/Imu: stamps and angular velocities, as they are.

    Raises
    ------
    RecordError
        If a message is too short for its own content or is not plain CDR.
    """
    stamp_ns, rate = np.empty(len(messages), np.int64), np.empty((len(messages), 3))
    for rows, order in by_byte_order(messages):
        start = messages.start[rows] + ENCAPSULATION
        size = messages.size[rows] - ENCAPSULATION
        require(size, HEADER.itemsize, IMU_TYPE)
        header = gather(messages.data, start, HEADER.newbyteorder(order))
        numbers = HEADER.itemsize + header['frame_id_length'].astype(np.int64) + 7 & ~7
        require(size, numbers + 8 * _IMU_NUMBERS, IMU_TYPE)
        stamp_ns[rows] = header_stamp_ns(header)
        rate[rows] = gather(messages.data, start + numbers + 8 * _RATE,
                            np.dtype([('rate', f'{order}f8', 3)]))['rate']
    return GyroSamples(stamp_ns, rate)


def header_stamp_ns(header: NDArray[np.void]) -> NDArray[np.int64]:
    """Return the stamps of std_msgs/Header, (n,) ns since the epoch."""
    stamp_ns: NDArray[np.int64] = header['sec'] * np.int64(10**9) + header['nanosec']
    return stamp_ns
