# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The topics of the suite: the only place that has their names."""

from __future__ import annotations

from typing import NamedTuple


class Topic(NamedTuple):
    """A topic of the suite; the name is relative, so it may stand in a namespace."""

    name: str
    type_name: str
    latched: bool = False
    result: bool = False


TOPICS = (
    Topic('imu/data_raw', 'sensor_msgs/msg/Imu'),
    Topic('star_tracker/centroids', 'sensor_msgs/msg/PointCloud2'),
    Topic('star_tracker/camera_info', 'sensor_msgs/msg/CameraInfo', latched=True),
    Topic('star_tracker/image_raw', 'sensor_msgs/msg/Image'),
    Topic('star_tracker/spots', 'sensor_msgs/msg/PointCloud2'),
    Topic('truth/centroids', 'sensor_msgs/msg/PointCloud2'),
    Topic('truth/attitude', 'geometry_msgs/msg/QuaternionStamped'),
    Topic('truth/parameters', 'std_msgs/msg/Float64MultiArray', latched=True),
    Topic('starcal/imu', 'sensor_msgs/msg/Imu', result=True),
    Topic('starcal/camera_info', 'sensor_msgs/msg/CameraInfo', latched=True, result=True),
    Topic('starcal/gyro_bias', 'geometry_msgs/msg/TwistWithCovarianceStamped', latched=True,
          result=True),
    Topic('starcal/mounting', 'geometry_msgs/msg/PoseWithCovarianceStamped', latched=True,
          result=True),
    Topic('starcal/state', 'std_msgs/msg/Float64MultiArray', latched=True, result=True),
    Topic('starcal/residuals', 'sensor_msgs/msg/PointCloud2', latched=True, result=True),
    Topic('starcal/intrinsics/camera_info', 'sensor_msgs/msg/CameraInfo', latched=True,
          result=True),
    Topic('starcal/intrinsics/state', 'std_msgs/msg/Float64MultiArray', latched=True,
          result=True),
    Topic('diagnostics', 'diagnostic_msgs/msg/DiagnosticArray', result=True),
    Topic('/tf_static', 'tf2_msgs/msg/TFMessage', latched=True, result=True),
)
GYRO = 'imu/data_raw'
STARS = ('star_tracker/centroids', 'star_tracker/spots', 'star_tracker/image_raw')
"""What star trackers deliver: each is made of the next where it is not there."""
