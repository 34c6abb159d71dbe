"""Keep the nodes of the tests away from every other ROS 2 node and from the user's logs."""

import os
import tempfile
from pathlib import Path

_LOGS = tempfile.TemporaryDirectory(prefix='starcal_ros_test_')
_PROFILE = Path(__file__).parents[1] / 'config' / 'fastdds_fast_discovery.xml'

os.environ.update(
    ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST',
    ROS_DOMAIN_ID=str(1 + os.getpid() % 100),  # above 101 its ports meet Linux's ephemeral ones
    ROS_LOG_DIR=_LOGS.name,
    FASTDDS_DEFAULT_PROFILES_FILE=str(_PROFILE),  # Fast DDS 3
    FASTRTPS_DEFAULT_PROFILES_FILE=str(_PROFILE),  # Fast DDS 2: ROS 2 Jazzy
)
