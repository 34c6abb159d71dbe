# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the estimator says of a frame, to CDR.

It is published as it is: messages of rclpy take ten times as long to be made and encoded. All
little-endian; the padding is zero.
"""

from __future__ import annotations

from collections.abc import Iterator
import struct
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import Detector
from starcal_ros.filter.belief import Belief
from starcal_ros.messages import conventions
from starcal_ros.messages.conventions import CALIBRATED_FRAME, GYRO_FRAME, OPTICAL_FRAME

if TYPE_CHECKING:
    from starcal_ros.filter.frame_result import FrameResult

Part = int | str | bytes | NDArray[np.float64]
_WORD = struct.Struct('<I')
_RESIDUALS = {'u': 'f8', 'v': 'f8', 'du': 'f8', 'dv': 'f8', 'catalog_id': 'u4', 'nis': 'f4',
              'accepted': 'u1'}
_POINT = np.dtype([(name, f'<{kind}') for name, kind in _RESIDUALS.items()])
_DATATYPES = {'u1': 2, 'u4': 6, 'f4': 7, 'f8': 8}       # of sensor_msgs/PointField
_OFFSETS = np.cumsum([0, *(np.dtype(kind).itemsize for kind in _RESIDUALS.values())]).tolist()
_FIELDS = [part for (name, kind), offset in zip(_RESIDUALS.items(), _OFFSETS)
           for part in (name, offset, bytes([_DATATYPES[kind]]), 1)]


def encode_state(stamp_ns: int, belief: Belief) -> bytes:
    """Encode `starcal/state`."""
    data = conventions.state_vector(stamp_ns, belief)
    layout = conventions.STATE_LAYOUT
    dimensions = [part for label, size in layout for part in (label, size, size)]
    return _joined(len(layout), *dimensions, 0, len(data), data)


def encode_camera(stamp_ns: int, intrinsics: Array, detector: Detector) -> bytes:
    """Encode `starcal/camera_info`."""
    values = conventions.camera_info(intrinsics, detector)
    numbers = np.array([*values.D, *values.K, *np.eye(3).ravel(), *values.P])
    return _joined(*_header(stamp_ns, CALIBRATED_FRAME), detector.height, detector.width,
                   'plumb_bob', len(values.D), numbers, *(0,) * 6, b'\0')


def encode_bias(stamp_ns: int, bias: Array, covariance: Array) -> bytes:
    """Encode `starcal/gyro_bias`, of a bias (3,) and the covariance (16, 16) of the states."""
    return _joined(*_header(stamp_ns, GYRO_FRAME), np.concatenate(
        (np.zeros(3), bias, conventions.bias_covariance(covariance).ravel())))


def encode_mounting(stamp_ns: int, C_sg: Array, covariance: Array) -> bytes:
    """Encode `starcal/mounting`, of C_sg (3, 3) and the covariance (16, 16) of the states."""
    return _joined(*_header(stamp_ns, GYRO_FRAME), np.zeros(3), np.concatenate(
        (rotation.to_quaternion(conventions.optical_in_gyro(C_sg)),
         conventions.mounting_covariance(C_sg, covariance).ravel())))


def encode_transforms(stamp_ns: int, C_sg: Array) -> bytes:
    """Encode what is on ``/tf_static``: gyro -> star_tracker_optical -> the same, calibrated.

    The second is the identity, for `starcal/camera_info` (`conventions.CALIBRATED_FRAME`).
    """
    def of(parent: str, child: str, C: Array) -> Iterator[Part]:
        yield from _header(stamp_ns, parent)
        yield child
        yield np.concatenate((np.zeros(3), rotation.to_quaternion(C)))
    return _joined(2, *of(GYRO_FRAME, OPTICAL_FRAME, conventions.optical_in_gyro(C_sg)),
                   *of(OPTICAL_FRAME, CALIBRATED_FRAME, np.eye(3)))


def encode_residuals(result: FrameResult) -> bytes:
    """Encode `starcal/residuals`."""
    points = _points(result)
    return _joined(*_header(result.stamp_ns, OPTICAL_FRAME), 1, len(points), len(_RESIDUALS),
                   *_FIELDS, b'\0', points.itemsize, points.nbytes, points.nbytes,
                   points.tobytes(), b'\1')


def _points(result: FrameResult) -> NDArray[np.void]:
    """Return the points of `starcal/residuals`, without stars that have no residual."""
    known = np.isfinite(result.residual).all(axis=1) & np.isfinite(result.chi2)
    points = np.empty(int(known.sum()), _POINT)
    points['u'], points['v'] = result.uv_raster[known].T
    points['du'], points['dv'] = result.residual[known].T
    points['catalog_id'] = result.catalog_id[known]
    points['nis'], points['accepted'] = result.chi2[known], result.accepted[known]
    return points


def _header(stamp_ns: int, frame_id: str) -> tuple[int, int, str]:
    sec, nanosec = divmod(stamp_ns, 10**9)
    return sec % 2**32, nanosec, frame_id


def _joined(*parts: Part) -> bytes:
    """Join numbers of 4 bytes, strings, bytes and float64 arrays, each aligned to its own size."""
    data = bytearray()
    for part in parts:
        if isinstance(part, bytes):
            data += part
        elif isinstance(part, np.ndarray):
            data += bytes(-len(data) % 8) + part.tobytes()
        else:
            text = part.encode() + b'\0' if isinstance(part, str) else b''
            number = len(text) if isinstance(part, str) else part
            data += bytes(-len(data) % 4) + _WORD.pack(number) + text
    return b'\0\1\0\0' + data
