# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Cameras, arrays and truth as messages, in the classes of whoever asks.

rclpy and rosbags have classes for the same types, which take the same keywords. All fields are
given: those of rosbags have no defaults.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import Detector
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.messages import conventions, topics


@dataclass(frozen=True)
class Types:
    """The message classes of a library.

    Attributes
    ----------
    named : callable
        Returns the class of a type such as ``sensor_msgs/msg/Imu``.
    sequence : callable
        Makes of an array (n,) what these classes take where a field has no fixed length.
    """

    named: Callable[[str], Any]
    sequence: Callable[[NDArray[Any]], Any]


class Contents:
    """Makes messages of arrays.

    Parameters
    ----------
    types : Types
        Of which classes.
    """

    def __init__(self, types: Types) -> None:
        self._types = types

    def camera_info(self, stamp_ns: int, intrinsics: Array, detector: Detector, frame_id: str
                    ) -> Any:
        """Return a camera as sensor_msgs/CameraInfo; each has a frame of its own."""
        values = conventions.camera_info(intrinsics, detector)
        return self._new(
            topics.CAMERA.type_name, header=self._header(stamp_ns, frame_id),
            height=detector.height, width=detector.width, distortion_model='plumb_bob',
            d=self._types.sequence(np.array(values.D)), k=np.array(values.K),
            r=np.eye(3).ravel(), p=np.array(values.P), binning_x=0, binning_y=0,
            roi=self._new('sensor_msgs/msg/RegionOfInterest', x_offset=0, y_offset=0, height=0,
                          width=0, do_rectify=False))

    def labelled(self, layout: Sequence[tuple[str, int]], data: Array) -> Any:
        """Return an array of parts that stand one after the other, each with label and size."""
        dimensions = [self._new('std_msgs/msg/MultiArrayDimension', label=label, size=size,
                                stride=size) for label, size in layout]
        return self._new(
            'std_msgs/msg/Float64MultiArray', data=self._types.sequence(data),
            layout=self._new('std_msgs/msg/MultiArrayLayout', dim=dimensions, data_offset=0))

    def intrinsics(self, stamp_ns: int, estimate: CameraEstimate) -> Any:
        """Return `starcal/intrinsics/state`."""
        return self.labelled(conventions.INTRINSICS_LAYOUT, np.concatenate((
            [stamp_ns * 1e-9], estimate.intrinsics, estimate.covariance.ravel())))

    def _new(self, type_name: str, **fields: Any) -> Any:
        return self._types.named(type_name)(**fields)

    def _header(self, stamp_ns: int, frame_id: str) -> Any:
        return self._new('std_msgs/msg/Header', frame_id=frame_id, stamp=self._stamp(stamp_ns))

    def _stamp(self, stamp_ns: int) -> Any:
        sec, nanosec = divmod(stamp_ns, 10**9)
        return self._new('builtin_interfaces/msg/Time', sec=sec, nanosec=nanosec)

    def _vector(self, values: Array) -> Any:
        return self._new('geometry_msgs/msg/Vector3', **dict(zip('xyz', values.tolist())))

    def _quaternion(self, C: Array) -> Any:
        return self._new('geometry_msgs/msg/Quaternion',
                         **dict(zip('xyzw', rotation.to_quaternion(C).tolist())))
