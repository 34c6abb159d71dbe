# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A node of the test's own process that talks to the nodes under test."""

import time

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu, PointCloud2
from std_msgs.msg import Float64MultiArray

from starcal_ros.messages import cdr_imu, cdr_pointcloud

PATIENCE_S = 60.0
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Peer:
    """Publishes what sensors would and keeps what the estimator answers."""

    def __init__(self, namespace='', gyro_qos=QoSProfile(depth=5000)):
        self.node = rclpy.create_node('peer', namespace=namespace)
        self.gyro = self.node.create_publisher(Imu, 'imu/data_raw', gyro_qos)
        self.frames = self.node.create_publisher(PointCloud2, 'star_tracker/centroids', 1000)
        self.states = self.listen(Float64MultiArray, 'starcal/state', LATCHED)
        self.diagnostics = self.listen(DiagnosticArray, 'diagnostics')

    def listen(self, kind, topic, qos=100):
        """Return a list that the messages of a topic are appended to."""
        heard = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

    def until(self, condition):
        """Spin until something holds."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, 'waited in vain'
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def meet(self):
        """Wait until the estimator listens and is heard."""
        self.until(lambda: all(p.get_subscription_count() for p in (self.gyro, self.frames)))
        self.until(lambda: self.node.count_publishers('starcal/state') == 1)

    def send(self, gyro, frames, gyro_frame='gyro'):
        """Publish messages."""
        for message in cdr_imu.encode_imu(gyro, gyro_frame):
            self.gyro.publish(message.tobytes())
        for message in cdr_pointcloud.encode_centroids(frames):
            self.frames.publish(message)

    def call(self, kind, name, request=None):
        """Call a service.

        An answer is lost where the server has not discovered who asks by then, which a loaded
        machine makes happen: it is asked for again.
        """
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready)
        futures, again = [], 0.0

        def answered():
            nonlocal again
            if time.monotonic() > again:
                futures.append(client.call_async(request or kind.Request()))
                again = time.monotonic() + PATIENCE_S / 4
            return any(future.done() for future in futures)

        self.until(answered)
        self.node.destroy_client(client)
        return next(future.result() for future in futures if future.done())

    def status(self):
        """Return the next diagnostics: of the calibration and of the inputs."""
        self.diagnostics.clear()
        self.until(lambda: self.diagnostics)
        return self.diagnostics[-1].status

    def values(self):
        """Return what the next diagnostics say of the calibration, by key."""
        return {item.key: item.value for item in self.status()[0].values}
