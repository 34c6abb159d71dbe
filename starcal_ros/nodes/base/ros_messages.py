# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimates and truth as ROS messages."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import (PoseWithCovarianceStamped, Quaternion, QuaternionStamped,
                               TransformStamped, TwistWithCovarianceStamped)
import numpy as np
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2, PointField
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import Detector
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.filter.attitude_track import AttitudeTrack
from starcal_ros.filter.belief import Belief
from starcal_ros.filter.calibrator import FrameResult
from starcal_ros.filter.states import EPSILON
from starcal_ros.messages import conventions
from starcal_ros.messages.conventions import GYRO_FRAME, INERTIAL_FRAME, OPTICAL_FRAME

_RESIDUALS = np.dtype([('u', '<f8'), ('v', '<f8'), ('du', '<f8'), ('dv', '<f8'),
                       ('catalog_id', '<u4'), ('nis', '<f4'), ('accepted', 'u1')])
_DATATYPES = {'<f8': PointField.FLOAT64, '<f4': PointField.FLOAT32, '<u4': PointField.UINT32,
              '|u1': PointField.UINT8}


def header(stamp_ns: int, frame_id: str) -> Header:
    """Return a header."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def quaternion(C: Array) -> Quaternion:
    """Return a rotation matrix as a quaternion message."""
    x, y, z, w = rotation.to_quaternion(C).tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def imus(track: AttitudeTrack, rate_covariance: Array) -> list[Imu]:
    """Return `starcal/imu`: orientation of gyro in icrf, its covariance about the axes of icrf.

    The covariance of the rate, (3, 3), is about the axes of gyro; there is no acceleration.
    """
    messages, rate_covariance = [], rate_covariance.ravel()
    q_ig = rotation.to_quaternion(np.swapaxes(track.C_gi, -1, -2))
    for stamp_ns, q, covariance, rate in zip(
            track.stamp_ns.tolist(), q_ig.tolist(), track.covariance, track.rate.tolist()):
        message = Imu(header=header(stamp_ns, GYRO_FRAME))
        orientation, velocity = message.orientation, message.angular_velocity
        orientation.x, orientation.y, orientation.z, orientation.w = q
        velocity.x, velocity.y, velocity.z = rate
        message.orientation_covariance = covariance.ravel()
        message.angular_velocity_covariance = rate_covariance
        message.linear_acceleration_covariance[0] = -1.0        # REP-145: not measured
        messages.append(message)
    return messages


def camera_info(stamp_ns: int, intrinsics: Array, detector: Detector) -> CameraInfo:
    """Return a camera as CameraInfo."""
    values = conventions.camera_info(intrinsics, detector)
    return CameraInfo(
        header=header(stamp_ns, OPTICAL_FRAME), width=detector.width, height=detector.height,
        distortion_model='plumb_bob', k=values.K, d=values.D, p=values.P,
        r=np.eye(3).ravel().tolist())


def gyro_bias(stamp_ns: int, belief: Belief, covariance: Array) -> TwistWithCovarianceStamped:
    """Return `starcal/gyro_bias`, in its angular part [rad/s]."""
    message = TwistWithCovarianceStamped(header=header(stamp_ns, GYRO_FRAME))
    bias = message.twist.twist.angular
    bias.x, bias.y, bias.z = belief.estimate.bias.tolist()
    spread = np.zeros((6, 6))
    spread[3:, 3:] = covariance[EPSILON, EPSILON]
    message.twist.covariance = spread.ravel()
    return message


def mounting(stamp_ns: int, belief: Belief, covariance: Array) -> PoseWithCovarianceStamped:
    """Return `starcal/mounting`: orientation of star_tracker_optical in gyro."""
    C_sg = belief.estimate.C_sg
    message = PoseWithCovarianceStamped(header=header(stamp_ns, GYRO_FRAME))
    message.pose.pose.orientation = quaternion(conventions.optical_in_gyro(C_sg))
    message.pose.covariance = conventions.mounting_covariance(C_sg, covariance).ravel()
    return message


def mounting_transform(stamp_ns: int, belief: Belief) -> TransformStamped:
    """Return the mounting as the transform gyro -> star_tracker_optical."""
    message = TransformStamped(header=header(stamp_ns, GYRO_FRAME), child_frame_id=OPTICAL_FRAME)
    C_go = conventions.optical_in_gyro(belief.estimate.C_sg)
    message.transform.rotation = quaternion(C_go)
    return message


def labelled(parts: list[tuple[str, int]], data: Array) -> Float64MultiArray:
    """Return an array of parts that stand one after the other, each with label and size."""
    dimensions = [MultiArrayDimension(label=label, size=size, stride=size)
                  for label, size in parts]
    return Float64MultiArray(layout=MultiArrayLayout(dim=dimensions), data=data.tolist())


def state(stamp_ns: int, belief: Belief) -> Float64MultiArray:
    """Return `starcal/state`."""
    return labelled(list(conventions.STATE_LAYOUT),
                    conventions.state_vector(stamp_ns, belief))


def intrinsics(stamp_ns: int, estimate: CameraEstimate) -> Float64MultiArray:
    """Return `starcal/intrinsics/state`."""
    return labelled(list(conventions.INTRINSICS_LAYOUT), np.concatenate((
        [stamp_ns * 1e-9], estimate.intrinsics, estimate.covariance.ravel())))


def residuals(result: FrameResult) -> PointCloud2:
    """Return `starcal/residuals`: measured minus predicted, without the stars that have none."""
    known = np.isfinite(result.residual).all(axis=1) & np.isfinite(result.chi2)
    points = np.empty(int(known.sum()), _RESIDUALS)
    points['u'], points['v'] = result.uv_raster[known].T
    points['du'], points['dv'] = result.residual[known].T
    points['catalog_id'] = result.catalog_id[known]
    points['nis'], points['accepted'] = result.chi2[known], result.accepted[known]
    fields = [PointField(name=name, offset=offset, datatype=_DATATYPES[kind.str], count=1)
              for name, (kind, offset) in _RESIDUALS.fields.items()]
    return PointCloud2(
        header=header(result.stamp_ns, OPTICAL_FRAME), height=1, width=len(points),
        fields=fields, is_bigendian=False, point_step=_RESIDUALS.itemsize,
        row_step=points.nbytes, data=points.tobytes(), is_dense=True)


def attitude(stamp_ns: int, C_ig: Array) -> QuaternionStamped:
    """Return an orientation of gyro in icrf."""
    return QuaternionStamped(header=header(stamp_ns, INERTIAL_FRAME), quaternion=quaternion(C_ig))
