# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The command line of a node: ROS arguments, help, and nothing that would be passed over."""

from __future__ import annotations

from inspect import cleandoc
import sys

from rclpy.utilities import remove_ros_args

from starcal_ros.config.shipped import config_file

_ROS_ARGUMENTS = '--ros-args [--params-file FILE] [-p NAME:=VALUE ...] [-r FROM:=TO ...]'
_HELP = ('-h', '--help')
JSON = '--json'


def words(args: list[str] | None) -> list[str]:
    """Return what the command line, ``sys.argv`` by default, holds beside ROS arguments.

    Nothing, where the ROS arguments can not be read: `rclpy.init` says what is wrong with them.
    """
    try:
        return list(remove_ros_args(sys.argv if args is None else args)[1:])
    except RuntimeError:
        return []


def asks_for_help(given: list[str]) -> bool:
    """Tell whether the words of a command line ask for help."""
    return any(word in _HELP for word in given)


def help_text(module: str, doc: str | None, takes: str = '') -> str:
    """Return the help of a program.

    Parameters
    ----------
    module : str
        Its module, which ends in the program's name.
    doc : str or None
        What the module says of it.
    takes : str
        What the program takes beside ROS arguments.
    """
    name = module.rpartition('.')[2]
    return (f'usage: ros2 run starcal_ros {name} {takes}{_ROS_ARGUMENTS}\n\n'
            f'{cleandoc(doc or "")}\n\n'
            f'An example of a parameter file: {config_file("tan2018.yaml")}\n'
            f'To write one: starcal config new; what is wrong in one: starcal config check FILE\n'
            f'All parameters: starcal config list, docs/parameters.md; of the running node:\n'
            f'ros2 param list NODE; text, unit and range of one: starcal config describe NAME,\n'
            f'or ros2 param describe NODE NAME')


def tell(line: str) -> bool:
    """Write a line on standard output; return whether somebody reads it."""
    try:
        print(line, flush=True)
    except OSError:
        return False
    return True


def refusal(given: list[str]) -> str:
    """Return what to say of words that a node does not know."""
    return (f'error: got {" ".join(given)}, a node takes nothing but ROS arguments: '
            f'{_ROS_ARGUMENTS}')
