# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Arithmetic that is compiled where numba is installed, and runs by numpy where it is not."""

from __future__ import annotations

import sys


def say_uncompiled(what: str, error: Exception) -> None:
    """Say that something runs uncompiled, and why, unless numba is just not installed.

    Its cache may have no place, be full, or be damaged.
    """
    if not isinstance(error, ModuleNotFoundError):
        print(f'starcal_ros: {what} runs uncompiled: {error or type(error).__name__}',
              file=sys.stderr)
