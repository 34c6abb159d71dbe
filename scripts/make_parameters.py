#!/usr/bin/env python3
# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Write what is made of the declared parameters: docs/parameters.md and the schema of editors.

Usage::

    python scripts/make_parameters.py
"""

from __future__ import annotations

import json
from pathlib import Path

from starcal_ros.config.parameter_page import page
from starcal_ros.config.schema import schema

TOP = Path(__file__).parents[1]
MADE = {'docs/parameters.md': page,
        'config/parameters.schema.json': lambda: json.dumps(schema(), indent=1) + '\n'}
"""Files by their path in the repository, and what makes their text."""


def main() -> int:
    """Write the files."""
    for name, make in MADE.items():
        (TOP / name).write_text(make())
        print(name)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
