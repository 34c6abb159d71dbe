#!/usr/bin/env python3
# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Publish gyro readings and star centroids of a device: an example driver.

    cat /dev/ttyUSB0 | python examples/driver.py [--ros-args -r __ns:=/my_namespace]

The device of this example speaks lines, one a reading and one a frame. Replace `read_line` by what
yours speaks; the rest is what the estimator asks of any driver (docs/howto/driver.md). ::

    gyro STAMP_NS WX WY WZ                  end of the interval; mean rate over it [rad/s]
    stars STAMP_NS {U V HIP SIGMA MAG}      middle of the exposure; raster pixels, 0: not known

Stamps are UTC, in ns since the Unix epoch. It needs rclpy and sensor_msgs alone.
"""

import struct
import sys

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, PointCloud2, PointField

RELIABLE = ReliabilityPolicy.RELIABLE
GYRO_QOS = QoSProfile(depth=1000, reliability=RELIABLE)     # some seconds: none may be lost
STARS_QOS = QoSProfile(depth=50, reliability=RELIABLE)

# Name, place and type of each field of a star, as they lie in 28 bytes.
POINT = struct.Struct('<ddIff')
FIELDS = (('u', 0, PointField.FLOAT64), ('v', 8, PointField.FLOAT64),
          ('catalog_id', 16, PointField.UINT32), ('sigma', 20, PointField.FLOAT32),
          ('magnitude', 24, PointField.FLOAT32))


class Driver(Node):
    """Turns lines into messages."""

    def __init__(self) -> None:
        super().__init__('star_tracker_driver')
        self._gyro = self.create_publisher(Imu, 'imu/data_raw', GYRO_QOS)
        self._stars = self.create_publisher(PointCloud2, 'star_tracker/centroids', STARS_QOS)

    def publish(self, line: str) -> None:
        """Publish what a line says; a line that says nothing is told of and passed over."""
        kind, _, rest = line.partition(' ')
        try:
            stamp_ns, values = read_line(rest)
            if kind == 'gyro' and len(values) == 3:
                self._gyro.publish(imu(stamp_ns, values))
            elif kind == 'stars' and len(values) % 5 == 0:
                self._stars.publish(cloud(stamp_ns, values))
            else:
                raise ValueError(f'{kind!r} with {len(values)} numbers')
        except (ValueError, OverflowError, struct.error) as error:
            self.get_logger().warning(f'passed over: {error}', throttle_duration_sec=1.0)


def read_line(text: str) -> tuple[int, list[float]]:
    """Return stamp and numbers of a line."""
    stamp_ns, *values = text.split()
    return int(stamp_ns), [float(value) for value in values]


def imu(stamp_ns: int, rate: list[float]) -> Imu:
    """Return a gyro reading as a message."""
    message = Imu()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.header.frame_id = 'gyro'
    message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z = rate
    # What is not measured says so (REP-145).
    message.orientation_covariance[0] = message.linear_acceleration_covariance[0] = -1.0
    return message


def cloud(stamp_ns: int, values: list[float]) -> PointCloud2:
    """Return the stars of a frame as a message; of a frame without stars one without points."""
    stars = [values[k:k + 5] for k in range(0, len(values), 5)]
    message = PointCloud2()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.header.frame_id = 'star_tracker_optical'
    message.height, message.width = 1, len(stars)
    message.fields = [PointField(name=name, offset=offset, datatype=datatype, count=1)
                      for name, offset, datatype in FIELDS]
    message.point_step, message.row_step = POINT.size, POINT.size * len(stars)
    message.is_dense = True
    message.data = b''.join(POINT.pack(u, v, int(hip), sigma, magnitude)
                            for u, v, hip, sigma, magnitude in stars)
    return message


def main() -> None:
    """Publish until the device ends."""
    rclpy.init()
    driver = Driver()
    try:
        for line in sys.stdin:
            if line.strip():
                driver.publish(line)
        # What was sent last arrives before the node goes.
        for publisher in driver.publishers:
            publisher.wait_for_all_acked()
    except KeyboardInterrupt:
        pass
    finally:
        driver.destroy_node()
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
