# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Arguments that several commands share, and what becomes of them."""

from __future__ import annotations

import argparse
from pathlib import Path

from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.config.shipped import config_file


def add_bag(parser: argparse.ArgumentParser) -> None:
    """Add the recording."""
    parser.add_argument('bag', metavar='BAG', help='.mcap file or rosbag2 directory')


def add_config(parser: argparse.ArgumentParser) -> None:
    """Add ``--config``, for `scenario`."""
    parser.add_argument(
        '--config', metavar='FILE', help='parameter file of the scenario (ROS 2 parameters, '
        '/**: ros__parameters:); default: the shipped tan2018.yaml')


def add_duration(parser: argparse.ArgumentParser) -> None:
    """Add ``--duration``, for `scenario`."""
    parser.add_argument('--duration', metavar='S', type=float,
                        help='simulated seconds, in place of simulation.duration_s')


def scenario(options: argparse.Namespace, **values: object) -> Scenario:
    """Return the scenario of ``--config``; values that are not None replace its parameters.

    Parameters
    ----------
    options : Namespace
        With ``config``.
    values
        Parameters of the group ``simulation``, by name.
    """
    path = options.config or config_file('tan2018.yaml')
    given = {key: value for key, value in values.items() if value is not None}
    return parameter_file.load(path).replace(
        {f'simulation.{key}': value for key, value in given.items()})


def require_writable(path: Path) -> None:
    """Try it now, not after the work."""
    existed = path.exists()
    try:
        path.open('a').close()
    except OSError as error:
        raise ConfigError(f'{path}: cannot be written: {error.strerror}') from None
    if not existed:
        path.unlink()


def make_folder(path: Path) -> None:
    """Make a folder to write to, before the work."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f'{path}: cannot be made: {error.strerror}') from None
