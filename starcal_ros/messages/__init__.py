# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is on the topics, as arrays and as bytes: names, conventions of ROS, CDR.

No rclpy, and no recording: these are the same bytes whether they come from one or the other.
"""
