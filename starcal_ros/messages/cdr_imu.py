# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gyro samples to and from CDR, and attitudes to it, many messages at once.

::

    sensor_msgs/Imu     sec i4 | nanosec u4 | frame_id: length u4, bytes, NUL | pad to 8 |
                        37 float64: orientation 4, its covariance 9, angular velocity 3,
                        its covariance 9, linear acceleration 3, its covariance 9
    geometry_msgs/QuaternionStamped     the same header | pad to 8 | 4 float64

The length of ``frame_id`` alone decides where the numbers stand: messages of one sender are the
rows of one array, and a few gathers read any number of others.
"""

from __future__ import annotations

from functools import lru_cache
import struct
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.messages.cdr import (ENCAPSULATION, HEADER, ByteOrder, Messages, by_byte_order,
                                      gather, header_stamp_ns, require)

if TYPE_CHECKING:
    from starcal_ros.filter.attitude_track import AttitudeTrack

IMU_TYPE = 'sensor_msgs/msg/Imu'
_IMU_NUMBERS = 37
_LAYOUTS = 16           # that are remembered
_ORIENTATION_W, _ORIENTATION_COVARIANCE = 3, 4
_RATE, _RATE_COVARIANCE, _ACCELERATION_COVARIANCE = 13, 16, 28


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
    rows = _rows(samples.stamp_ns, frame_id)
    numbers = rows['numbers']
    numbers[:, _ORIENTATION_W] = 1.0
    numbers[:, [_ORIENTATION_COVARIANCE, _ACCELERATION_COVARIANCE]] = -1.0
    numbers[:, _RATE:_RATE + 3] = samples.rate
    numbers[:, _RATE_COVARIANCE:_RATE_COVARIANCE + 9:4] = angular_velocity_variance
    return _bytes(rows)


def encode_attitudes(track: AttitudeTrack, rate_covariance: Array, frame_id: str = 'gyro'
                     ) -> NDArray[np.uint8]:
    """Encode attitudes at gyro stamps as sensor_msgs/Imu without acceleration (REP-145).

    Parameters
    ----------
    track : AttitudeTrack
        n attitudes; their covariance is about the axes of i.
    rate_covariance : (3, 3) array
        Of each angular velocity, about the axes of g [(rad/s)^2].
    frame_id : str
        Name of the gyro frame.

    Returns
    -------
    rows : (n, size) uint8 array
        One little-endian message a row.
    """
    rows = _rows(track.stamp_ns, frame_id)
    numbers, n = rows['numbers'], len(rows)
    numbers[:, :_ORIENTATION_COVARIANCE] = rotation.to_quaternion(
        np.swapaxes(track.C_gi, -1, -2))
    numbers[:, _ORIENTATION_COVARIANCE:_RATE] = track.covariance.reshape(n, 9)
    numbers[:, _RATE:_RATE_COVARIANCE] = track.rate
    numbers[:, _RATE_COVARIANCE:_RATE_COVARIANCE + 9] = rate_covariance.ravel()
    numbers[:, _ACCELERATION_COVARIANCE] = -1.0
    return _bytes(rows)


def encode_quaternions(stamp_ns: Ints, C: Array, frame_id: str) -> NDArray[np.uint8]:
    """Encode orientations as geometry_msgs/QuaternionStamped.

    Parameters
    ----------
    stamp_ns : (n,) int64 array
    C : (n, 3, 3) array
        Rotation matrices.
    frame_id : str
        Name of the frame that they lead to.

    Returns
    -------
    rows : (n, size) uint8 array
        One little-endian message a row.
    """
    rows = _rows(stamp_ns, frame_id, 4)
    rows['numbers'] = rotation.to_quaternion(C)
    return _bytes(rows)


def _rows(stamp_ns: Ints, frame_id: str, count: int = _IMU_NUMBERS) -> NDArray[np.void]:
    """Return messages with some numbers, of which all but the header is zero."""
    rows = _row(frame_id, count).repeat(len(stamp_ns))
    rows['sec'], rows['nanosec'] = np.divmod(stamp_ns, 10**9)
    return rows


@lru_cache(_LAYOUTS)
def _row(frame_id: str, count: int) -> NDArray[np.void]:
    """Return a message of which all but encapsulation and frame_id is zero, (1,)."""
    name = frame_id.encode() + b'\0'
    row = np.zeros(1, _layout(len(name), count, '<'))
    row['encapsulation'][:, 1] = 1
    row['length'], row['name'] = len(name), name
    return row


@lru_cache(_LAYOUTS)
def _layout(length: int, count: int, order: ByteOrder) -> np.dtype[np.void]:
    """Return the layout of messages by the length of their frame_id: all before the numbers."""
    padded = -(-(HEADER.itemsize + length) // 8) * 8 - HEADER.itemsize
    return np.dtype([('encapsulation', 'u1', ENCAPSULATION), ('sec', f'{order}i4'),
                     ('nanosec', f'{order}u4'), ('length', f'{order}u4'), ('name', f'S{padded}'),
                     ('numbers', f'{order}f8', count)])


def _bytes(rows: NDArray[np.void]) -> NDArray[np.uint8]:
    return rows.view(np.uint8).reshape(len(rows), rows.dtype.itemsize)


def decode_imu(messages: Messages) -> GyroSamples:
    """Decode sensor_msgs/Imu: stamps and angular velocities, as they are.

    Raises
    ------
    RecordError
        If a message is too short for its own content or is not plain CDR.
    """
    rows = _alike(messages)
    if rows is not None:
        return GyroSamples(header_stamp_ns(rows), np.array(
            rows['numbers'][:, _RATE:_RATE + 3], np.float64))
    return _decode_any(messages)


def _alike(messages: Messages) -> NDArray[np.void] | None:
    """Return messages that lie end to end and have one layout, (n,); None where they do not."""
    n, size = len(messages), int(messages.size[0]) if len(messages) else 0
    if size < ENCAPSULATION + HEADER.itemsize or n * size != len(messages.data) or (
            messages.start != np.arange(n) * size).any():
        return None
    table = messages.data.reshape(n, size)
    kind, length = table[:, :2], table[:, 12:16]
    if (kind != kind[0]).any() or (length != length[0]).any() or kind[0, 0] or kind[0, 1] > 1:
        return None
    order: ByteOrder = '<' if kind[0, 1] else '>'
    (number,) = struct.unpack(f'{order}I', length[0].tobytes())
    if size != ENCAPSULATION + (HEADER.itemsize + number + 7 & ~7) + 8 * _IMU_NUMBERS:
        return None
    rows: NDArray[np.void] = table.view(_layout(number, _IMU_NUMBERS, order))[:, 0]
    return rows


def _decode_any(messages: Messages) -> GyroSamples:
    """Do as `decode_imu`, for messages of any layouts."""
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
