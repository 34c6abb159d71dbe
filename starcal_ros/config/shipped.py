# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the shipped configuration is: in a checkout, a wheel's prefix or a colcon workspace."""

from __future__ import annotations

from pathlib import Path


def config_file(name: str) -> Path:
    """Return the path of a shipped file of ``config/``.

    Raises
    ------
    FileNotFoundError
        Where the installation is incomplete.
    """
    package = Path(__file__).resolve().parent
    for parent in package.parents:
        for folder in (parent / 'share' / 'starcal_ros' / 'config', parent / 'config'):
            if (folder / name).is_file():
                return folder / name
    raise FileNotFoundError(f'{name} is not beside {package}: starcal_ros is not fully installed')
