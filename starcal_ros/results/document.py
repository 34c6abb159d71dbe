# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Results as files: JSON, and what is said where there is none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from starcal_ros.files.output import write_text


class CalibrationError(ValueError):
    """The messages give no calibration, or a file has none; the text says why."""


def dumps(values: dict[str, Any]) -> str:
    """Return a dictionary as JSON; NaN and infinity are refused."""
    return json.dumps(values, indent=1, allow_nan=False) + '\n'


def write_json(path: str | Path, values: dict[str, Any]) -> None:
    """Write a dictionary as JSON; NaN and infinity are refused.

    Raises
    ------
    OutputError
        Where the file cannot be written.
    """
    write_text(path, dumps(values))
