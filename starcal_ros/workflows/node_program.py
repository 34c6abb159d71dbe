# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A node of the suite as a process of its own; nothing of ROS 2 is imported here."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
import sys


# With the search path of this process: that of `python -m` begins with the working directory,
# where a checkout may lie that is not what is installed.
_PROGRAM = """import sys
sys.path[:] = {path!r}
from starcal_ros.nodes import programs
sys.exit(getattr(programs, sys.argv.pop(1))())
"""


class NodeError(RuntimeError):
    """A node ended as it should not; the message names it."""


def node_command(name: str, parameters: Mapping[str, object], params_file: Path | None = None,
                 namespace: str | None = None, as_json: bool = False) -> list[str]:
    """Return the command line of a node of the suite.

    Raises
    ------
    NodeError
        Where there is no ROS 2.
    """
    if find_spec('rclpy') is None:
        raise NodeError("no ROS 2 here (rclpy): source a distribution, or pip install '.[ros]'")
    command = [sys.executable, '-c', _PROGRAM.format(path=sys.path), name,
               *(['--json'] if as_json else []), '--ros-args']
    if params_file is not None:
        command += ['--params-file', str(params_file)]
    for key, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        command += ['-p', f'{key}:={text}']
    if namespace is not None:
        command += ['-r', f'__ns:=/{namespace.strip("/")}']
    return command
