# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Arithmetic that is compiled where numba is installed, and runs by numpy where it is not."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray


def say_uncompiled(what: str, error: Exception) -> None:
    """Say that something runs uncompiled, and why, unless numba is just not installed.

    Its cache may have no place, be full, or be damaged.
    """
    if not isinstance(error, ModuleNotFoundError):
        print(f'starcal_ros: {what} runs uncompiled: {error or type(error).__name__}',
              file=sys.stderr)


def ready(part: NDArray[Any]) -> NDArray[Any]:
    """Return an array as the compiled functions take it: contiguous and writable."""
    return part if part.flags.carray else np.array(part, order='C')
