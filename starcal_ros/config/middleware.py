# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The settings of the middleware: quick nodes, and nodes that only this machine reaches."""

from __future__ import annotations

import os
from pathlib import Path
import sys

from starcal_ros.config.shipped import config_file

_KINDS = (('fastdds', 'FASTDDS_DEFAULT_PROFILES_FILE', ''),
          ('fastrtps', 'FASTRTPS_DEFAULT_PROFILES_FILE', '_2'))
"""Package of each version of Fast DDS, the variable that names its settings, the end of ours."""

_OWN = ('DEFAULT_FASTDDS_PROFILES.xml', 'DEFAULT_FASTRTPS_PROFILES.xml')
"""What Fast DDS reads from the folder where it is started."""

_RMW = 'rmw_fastrtps_cpp'


def profile(name: str = 'fastdds') -> dict[str, str]:
    """Return the environment variable that gives Fast DDS our settings.

    Empty where there is no Fast DDS, and where its user has settings of his own: by one of the
    variables, or a file in the folder where the node is started.
    """
    ours = next(({variable: str(config_file(f'{name}{end}.xml'))}
                 for package, variable, end in _KINDS if _is_installed(package)), {})
    given = {variable: os.environ[variable] for _, variable, _ in _KINDS if variable in os.environ}
    others = given and given != ours or any(Path(own).is_file() for own in _OWN)
    return {} if others else ours


def loopback(name: str = 'fastdds_loopback') -> dict[str, str]:
    """Return environment variables with which nodes are reached from this machine alone.

    With Fast DDS no socket is bound to an address of a network. With another middleware, and
    with settings of the user's own, the nodes find no other machine, but may be bound to it.
    """
    rmw = os.environ.get('RMW_IMPLEMENTATION') or (_RMW if _is_installed(_RMW) else '')
    if rmw.startswith('rmw_fastrtps') and (settings := profile(name)):
        return {'RMW_IMPLEMENTATION': rmw, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SYSTEM_DEFAULT',
                **settings}
    return {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', **profile()}


def _is_installed(package: str) -> bool:
    """Tell whether a package of ROS 2 is installed."""
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    return any(Path(prefix, 'share', package).is_dir() for prefix in prefixes if prefix)
