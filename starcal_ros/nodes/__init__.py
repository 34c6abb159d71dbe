# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes: thin shells around the core, and what they share."""
