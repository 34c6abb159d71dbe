# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Keep the nodes of the tests away from every other ROS 2 node and from the user's logs."""

import os
import tempfile

from starcal_ros.demo import isolated

_LOGS = tempfile.TemporaryDirectory(prefix='starcal_ros_test_')

os.environ.update(isolated(), ROS_LOG_DIR=_LOGS.name)
