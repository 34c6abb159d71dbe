# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings in and out: MCAP files and rosbag2 directories, whoever wrote them.

Nothing else in the package opens one. What the messages mean is told in `messages`.
"""
