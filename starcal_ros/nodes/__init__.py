# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes, one thin file each; what they share is in `base`.

The only wing that imports rclpy. A node turns messages into arrays, calls the core and turns what
it returns into messages.
"""
