# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Gyro samples to and from CDR, and attitudes to it, many messages at once.

::

    sensor_msgs/Imu     sec i4 | nanosec u4 | frame_id: length u4, bytes, NUL | pad to 8 |
                        37 float64: orientation 4, its covariance 9, angular velocity 3,
                        its covariance 9, linear acceleration 3, its covariance 9
    geometry_msgs/QuaternionStamped     the same header | pad to 8 | 4 float64

The length of ``frame_id`` alone decides where the numbers stand, so that a few gathers read any
number of messages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.messages.cdr import (ENCAPSULATION, HEADER, Messages, by_byte_order, gather,
                                      header_stamp_ns, require)

if TYPE_CHECKING:
    from starcal_ros.filter.attitude_track import AttitudeTrack

IMU_TYPE = 'sensor_msgs/msg/Imu'
_IMU_NUMBERS = 37
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
    name = frame_id.encode() + b'\0'
    padded = -(-(HEADER.itemsize + len(name)) // 8) * 8 - HEADER.itemsize
    dtype = np.dtype([('encapsulation', 'u1', ENCAPSULATION), ('sec', '<i4'), ('nanosec', '<u4'),
                      ('length', '<u4'), ('name', f'S{padded}'),
                      ('numbers', '<f8', count)])
    rows = np.zeros(len(stamp_ns), dtype)
    rows['encapsulation'][:, 1] = 1
    rows['sec'], rows['nanosec'] = np.divmod(stamp_ns, 10**9)
    rows['length'], rows['name'] = len(name), name
    return rows


def _bytes(rows: NDArray[np.void]) -> NDArray[np.uint8]:
    return rows.view(np.uint8).reshape(len(rows), rows.dtype.itemsize)


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
