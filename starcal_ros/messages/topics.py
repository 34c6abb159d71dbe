# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The topics of the suite: the only place that has their names."""

from __future__ import annotations

from typing import NamedTuple


class Topic(NamedTuple):
    """A topic of the suite.

    Attributes
    ----------
    name : str
        Relative, so that it may stand in a namespace.
    type_name : str
        As in ``sensor_msgs/msg/Imu``.
    latched : bool
        Whether who comes late gets the last message.
    result : bool
        Whether it is of an estimator, or made of what one publishes.
    """

    name: str
    type_name: str
    latched: bool = False
    result: bool = False

    @property
    def recorded(self) -> str:
        """The name in recordings of a suite without a namespace, as in ``/imu/data_raw``."""
        return '/' + self.name.lstrip('/')


IMU = Topic('imu/data_raw', 'sensor_msgs/msg/Imu')
CENTROIDS = Topic('star_tracker/centroids', 'sensor_msgs/msg/PointCloud2')
SPOTS = Topic('star_tracker/spots', 'sensor_msgs/msg/PointCloud2')
IMAGES = Topic('star_tracker/image_raw', 'sensor_msgs/msg/Image')
NOMINAL_CAMERA = Topic('star_tracker/camera_info', 'sensor_msgs/msg/CameraInfo', latched=True)

TRUE_CENTROIDS = Topic('truth/centroids', 'sensor_msgs/msg/PointCloud2')
TRUE_ATTITUDE = Topic('truth/attitude', 'geometry_msgs/msg/QuaternionStamped')
TRUE_PARAMETERS = Topic('truth/parameters', 'std_msgs/msg/Float64MultiArray', latched=True)

PROGRESS = Topic('simulation/progress', 'std_msgs/msg/Header', latched=True)
"""Of the simulators, for each other; not recorded."""

ATTITUDE = Topic('starcal/imu', 'sensor_msgs/msg/Imu', result=True)
STATE = Topic('starcal/state', 'std_msgs/msg/Float64MultiArray', latched=True, result=True)
CAMERA = Topic('starcal/camera_info', 'sensor_msgs/msg/CameraInfo', latched=True, result=True)
GYRO_BIAS = Topic('starcal/gyro_bias', 'geometry_msgs/msg/TwistWithCovarianceStamped',
                  latched=True, result=True)
MOUNTING = Topic('starcal/mounting', 'geometry_msgs/msg/PoseWithCovarianceStamped',
                 latched=True, result=True)
RESIDUALS = Topic('starcal/residuals', 'sensor_msgs/msg/PointCloud2', latched=True, result=True)
TRANSFORM = Topic('/tf_static', 'tf2_msgs/msg/TFMessage', latched=True, result=True)
MARKERS = Topic('starcal/display/markers', 'visualization_msgs/msg/MarkerArray', latched=True,
                result=True)
ANNOTATIONS = Topic('starcal/display/annotations', 'foxglove_msgs/msg/ImageAnnotations',
                    latched=True, result=True)
VALUES = Topic('starcal/display/values', 'std_msgs/msg/Float64MultiArray', latched=True,
               result=True)
INTRINSICS_CAMERA = Topic('starcal/intrinsics/camera_info', 'sensor_msgs/msg/CameraInfo',
                          latched=True, result=True)
INTRINSICS_STATE = Topic('starcal/intrinsics/state', 'std_msgs/msg/Float64MultiArray',
                         latched=True, result=True)
DIAGNOSTICS = Topic('diagnostics', 'diagnostic_msgs/msg/DiagnosticArray', result=True)

TOPICS = (IMU, CENTROIDS, NOMINAL_CAMERA, IMAGES, SPOTS, TRUE_CENTROIDS, TRUE_ATTITUDE,
          TRUE_PARAMETERS, ATTITUDE, CAMERA, GYRO_BIAS, MOUNTING, STATE, RESIDUALS,
          INTRINSICS_CAMERA, INTRINSICS_STATE, DIAGNOSTICS, MARKERS, ANNOTATIONS, VALUES,
          TRANSFORM)
STARS = (CENTROIDS, SPOTS, IMAGES)
"""What star trackers deliver: each is made of the next where it is not there."""
