# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The settings of the middleware with which our nodes find and answer each other quickly."""

from __future__ import annotations

import os
from pathlib import Path
import sys

from starcal_ros.config.shipped import config_file

_KINDS = (('fastdds', 'FASTDDS_DEFAULT_PROFILES_FILE', 'fastdds.xml'),
          ('fastrtps', 'FASTRTPS_DEFAULT_PROFILES_FILE', 'fastdds_2.xml'))
"""Package of each version of Fast DDS, the variable that names its settings, and ours."""

_OWN = ('DEFAULT_FASTDDS_PROFILES.xml', 'DEFAULT_FASTRTPS_PROFILES.xml')
"""What Fast DDS reads from the folder where it is started."""


def profile() -> dict[str, str]:
    """Return the environment variable that gives Fast DDS our settings.

    Empty where there is no Fast DDS, and where its user has settings of his own: by one of the
    variables, or a file in the folder where the node is started.
    """
    if any(variable in os.environ for _, variable, _ in _KINDS) or any(
            Path(name).is_file() for name in _OWN):
        return {}
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    return next(({variable: str(config_file(name))} for package, variable, name in _KINDS
                 if any(Path(prefix, 'share', package).is_dir() for prefix in prefixes if prefix)),
                {})
