# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimates and truth as messages, in the classes of whoever asks.

rclpy and rosbags have classes for the same types, which take the same keywords. All fields are
given: those of rosbags have no defaults.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import Detector
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.states import EPSILON
from starcal_ros.messages import conventions, topics
from starcal_ros.messages.conventions import (CALIBRATED_FRAME, GYRO_FRAME, INERTIAL_FRAME,
                                              OPTICAL_FRAME)

if TYPE_CHECKING:
    from starcal_ros.filter.frame_result import FrameResult

_RESIDUALS = {'u': 'f8', 'v': 'f8', 'du': 'f8', 'dv': 'f8', 'catalog_id': 'u4', 'nis': 'f4',
              'accepted': 'u1'}
_POINT = np.dtype([(name, f'<{kind}') for name, kind in _RESIDUALS.items()])
_OFFSETS = np.cumsum([0, *(np.dtype(kind).itemsize for kind in _RESIDUALS.values())]).tolist()
_DATATYPES = {'u1': 2, 'u4': 6, 'f4': 7, 'f8': 8}       # of sensor_msgs/PointField


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

    def gyro_bias(self, stamp_ns: int, bias: Array, covariance: Array) -> Any:
        """Return `starcal/gyro_bias`, in its angular part [rad/s].

        Parameters
        ----------
        stamp_ns : int
        bias : (3,) array
        covariance : (16, 16) array
            Of the states.
        """
        spread = np.zeros((6, 6))
        spread[3:, 3:] = covariance[EPSILON, EPSILON]
        twist = self._new('geometry_msgs/msg/Twist', linear=self._vector(np.zeros(3)),
                          angular=self._vector(bias))
        return self._new(
            topics.GYRO_BIAS.type_name, header=self._header(stamp_ns, GYRO_FRAME),
            twist=self._new('geometry_msgs/msg/TwistWithCovariance', twist=twist,
                            covariance=spread.ravel()))

    def mounting(self, stamp_ns: int, C_sg: Array, covariance: Array) -> Any:
        """Return `starcal/mounting`: orientation of star_tracker_optical in gyro.

        Parameters
        ----------
        stamp_ns : int
        C_sg : (3, 3) array
        covariance : (16, 16) array
            Of the states.
        """
        pose = self._new(
            'geometry_msgs/msg/Pose',
            position=self._new('geometry_msgs/msg/Point', x=0.0, y=0.0, z=0.0),
            orientation=self._quaternion(conventions.optical_in_gyro(C_sg)))
        return self._new(
            topics.MOUNTING.type_name, header=self._header(stamp_ns, GYRO_FRAME),
            pose=self._new(
                'geometry_msgs/msg/PoseWithCovariance', pose=pose,
                covariance=conventions.mounting_covariance(C_sg, covariance).ravel()))

    def transforms(self, stamp_ns: int, C_sg: Array) -> list[Any]:
        """Return what is on ``/tf_static``: gyro -> star_tracker_optical -> the same, calibrated.

        The second is the identity, for `starcal/camera_info` (`conventions.CALIBRATED_FRAME`).
        """
        mounting = conventions.optical_in_gyro(C_sg)
        return [self._transform(stamp_ns, GYRO_FRAME, OPTICAL_FRAME, mounting),
                self._transform(stamp_ns, OPTICAL_FRAME, CALIBRATED_FRAME, np.eye(3))]

    def labelled(self, layout: Sequence[tuple[str, int]], data: Array) -> Any:
        """Return an array of parts that stand one after the other, each with label and size."""
        dimensions = [self._new('std_msgs/msg/MultiArrayDimension', label=label, size=size,
                                stride=size) for label, size in layout]
        return self._new(
            'std_msgs/msg/Float64MultiArray', data=self._types.sequence(data),
            layout=self._new('std_msgs/msg/MultiArrayLayout', dim=dimensions, data_offset=0))

    def state(self, stamp_ns: int, belief: Belief) -> Any:
        """Return `starcal/state`."""
        return self.labelled(conventions.STATE_LAYOUT, conventions.state_vector(stamp_ns, belief))

    def intrinsics(self, stamp_ns: int, estimate: CameraEstimate) -> Any:
        """Return `starcal/intrinsics/state`."""
        return self.labelled(conventions.INTRINSICS_LAYOUT, np.concatenate((
            [stamp_ns * 1e-9], estimate.intrinsics, estimate.covariance.ravel())))

    def residuals(self, result: FrameResult) -> Any:
        """Return `starcal/residuals`: measured less predicted, without stars that have none."""
        known = np.isfinite(result.residual).all(axis=1) & np.isfinite(result.chi2)
        points = np.empty(int(known.sum()), _POINT)
        points['u'], points['v'] = result.uv_raster[known].T
        points['du'], points['dv'] = result.residual[known].T
        points['catalog_id'] = result.catalog_id[known]
        points['nis'], points['accepted'] = result.chi2[known], result.accepted[known]
        fields = [self._new('sensor_msgs/msg/PointField', name=name, count=1,
                            offset=offset, datatype=_DATATYPES[kind])
                  for (name, kind), offset in zip(_RESIDUALS.items(), _OFFSETS)]
        return self._new(
            topics.RESIDUALS.type_name, header=self._header(result.stamp_ns, OPTICAL_FRAME),
            height=1, width=len(points), fields=fields, is_bigendian=False,
            point_step=_POINT.itemsize, row_step=points.nbytes,
            data=self._types.sequence(np.frombuffer(points.tobytes(), np.uint8)), is_dense=True)

    def attitude(self, stamp_ns: int, C_ig: Array) -> Any:
        """Return an orientation of gyro in icrf."""
        return self._new(topics.TRUE_ATTITUDE.type_name,
                         header=self._header(stamp_ns, INERTIAL_FRAME),
                         quaternion=self._quaternion(C_ig))

    def _transform(self, stamp_ns: int, parent: str, child: str, C: Array) -> Any:
        """Return the orientation C of one frame in another as geometry_msgs/TransformStamped."""
        return self._new(
            'geometry_msgs/msg/TransformStamped', header=self._header(stamp_ns, parent),
            child_frame_id=child, transform=self._new(
                'geometry_msgs/msg/Transform', translation=self._vector(np.zeros(3)),
                rotation=self._quaternion(C)))

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
