# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``python -m starcal_ros.cli``."""

import sys

from starcal_ros.cli import main

if __name__ == '__main__':
    sys.exit(main())
