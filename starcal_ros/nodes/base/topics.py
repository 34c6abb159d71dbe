# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The topics of the suite, and what the graph knows of any topic."""

from __future__ import annotations

from importlib import import_module
from typing import NamedTuple

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile

from starcal_ros.recording.writer import LATCHED, Qos


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


def message_type(type_name: str) -> type | None:
    """Return the class of a message type, None where its package is not installed."""
    package, _, name = type_name.partition('/msg/')
    try:
        found: type | None = getattr(import_module(f'{package}.msg'), name, None)
    except ImportError:
        return None
    return found


def is_stamped(kind: type) -> bool:
    """Tell whether a message type begins with a header."""
    fields: dict[str, str] = kind.get_fields_and_field_types()      # type: ignore[attr-defined]
    return next(iter(fields.items()), None) == ('header', 'std_msgs/Header')


def offered_qos(node: Node, topic: str, latched: bool) -> tuple[Qos, ...]:
    """Return what each publisher of a topic offers; publishers that offer the same are one.

    History and depth may not travel over the wire; they are then those of the suite.
    """
    offers = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    if not offers:
        return (LATCHED,) if latched else (Qos(),)
    return tuple(dict.fromkeys(map(_qos, offers)))


def _qos(offer: QoSProfile) -> Qos:
    latched = offer.durability == DurabilityPolicy.TRANSIENT_LOCAL
    stated = offer.history in (HistoryPolicy.KEEP_LAST, HistoryPolicy.KEEP_ALL)
    return Qos(
        history=offer.history.name.lower() if stated else 'keep_last',
        depth=offer.depth if stated else (LATCHED if latched else Qos()).depth,
        reliability=offer.reliability.name.lower(), durability=offer.durability.name.lower(),
        deadline_ns=offer.deadline.nanoseconds, lifespan_ns=offer.lifespan.nanoseconds,
        liveliness=offer.liveliness.name.lower(),
        liveliness_lease_duration_ns=offer.liveliness_lease_duration.nanoseconds,
        avoid_ros_namespace_conventions=offer.avoid_ros_namespace_conventions)
