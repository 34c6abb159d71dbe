# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Arguments that several commands share, and what becomes of them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
import difflib
from pathlib import Path
from typing import TYPE_CHECKING

from starcal_ros.cli.terminal import say
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.shipped import config_file
from starcal_ros.recording.topic_choice import FRAMES, GYRO, IMAGE, Role, TopicChoice

if TYPE_CHECKING:
    from starcal_ros.config import parameter_file
    from starcal_ros.config.scenario import Scenario

SIMULATORS = ('star_tracker_sim', 'gyro_sim')
SIMULATED = (*SIMULATORS, 'estimator')
"""The nodes that simulation commands stand for, without and with what estimates."""


def add_bag(parser: argparse.ArgumentParser) -> None:
    """Add the recording."""
    parser.add_argument('bag', metavar='BAG', help='.mcap file or rosbag2 directory')


def one_of(names: Sequence[str]) -> Callable[[str], str]:
    """Return the type of an argument with choices: of a mistyped one it knows the nearest."""
    def word(text: str) -> str:
        if text not in names and (near := difflib.get_close_matches(text, names, n=1)):
            raise argparse.ArgumentTypeError(f'invalid choice: {text!r}; did you mean {near[0]}?')
        return text
    return word


def completed_by(action: argparse.Action, names: Callable[[], Iterable[str]]) -> None:
    """Let a shell complete an argument with some names (argcomplete)."""
    setattr(action, 'completer', lambda **_: names())


def port(text: str) -> int:
    """Return the number of a port, as the type of an argument."""
    if not (text.isascii() and text.isdigit() and int(text) < 65536):
        raise argparse.ArgumentTypeError(f'invalid port: {text!r}; 0 to 65535')
    return int(text)


def add_topics(parser: argparse.ArgumentParser, images: bool = True) -> None:
    """Add the options that choose topics of a recording, for `topics`."""
    add_gyro_topic(parser)
    _add_topic(parser, FRAMES, 'star centroids')
    if images:
        _add_topic(parser, IMAGE, 'star images')


def add_gyro_topic(parser: argparse.ArgumentParser) -> None:
    """Add ``--gyro-topic`` alone."""
    _add_topic(parser, GYRO, 'gyro readings')


def _add_topic(parser: argparse.ArgumentParser, role: Role, what: str) -> None:
    parser.add_argument(
        role.option, metavar='TOPIC', help=f'topic of the {what} ({role.type}), where a recording '
        f'has several; default: {role.topic}, or the only one of its kind')


def topics(options: argparse.Namespace) -> TopicChoice:
    """Return the topics that were chosen."""
    return TopicChoice(options.gyro_topic, options.frames_topic,
                       getattr(options, 'image_topic', None))


def add_config(parser: argparse.ArgumentParser, recorded: bool = False) -> None:
    """Add ``--config`` and ``--namespace``, for `scenario`, or for `scenario_of` a recording."""
    default = 'that of the recording' if recorded else 'the shipped tan2018.yaml'
    parser.add_argument(
        '--config', metavar='FILE', help='parameter file of the scenario (ROS 2 parameters, '
        f'/**: ros__parameters:); default: {default}')
    parser.add_argument(
        '--namespace', metavar='NS', help='namespace of the node whose sections of the file are '
        'read; default: that of the only section with its name, or the root')


def add_json(parser: argparse.ArgumentParser, what: str) -> None:
    """Add ``--json``; `terminal.show_json` prints what it is said to."""
    parser.add_argument('--json', action='store_true', help=f'print {what} as JSON, no tables')


def add_duration(parser: argparse.ArgumentParser) -> None:
    """Add ``--duration``, for `scenario`."""
    parser.add_argument('--duration', metavar='S', type=float,
                        help='simulated seconds, in place of simulation.duration_s')


def scenario(options: argparse.Namespace, nodes: Sequence[str], **values: object) -> Scenario:
    """Return the scenario of ``--config``; values that are not None replace its parameters.

    Parameters
    ----------
    options : Namespace
        With ``config`` and ``namespace``.
    nodes : sequence of str
        The nodes that the command stands for.
    values
        Parameters of the group ``simulation``, by name.
    """
    from starcal_ros.config import parameter_file
    reading = parameter_file.read_file(options.config or config_file('tan2018.yaml'), nodes,
                                       options.namespace)
    given = {key: value for key, value in values.items() if value is not None}
    return _said(reading).replace({f'simulation.{key}': value for key, value in given.items()})


def scenario_of(bag: str | Path, options: argparse.Namespace, nodes: Sequence[str]) -> Scenario:
    """Return the scenario of ``--config``, or else the one that a recording carries.

    Parameters
    ----------
    bag : path
        The recording.
    options : Namespace
        With ``config`` and ``namespace``.
    nodes : sequence of str
        The nodes that the command stands for.

    Raises
    ------
    ConfigError
        Where there is neither, or the recorded one states no instrument.
    """
    if options.config:
        return scenario(options, nodes)
    from starcal_ros.config import parameter_file
    from starcal_ros.config.instrument import CameraConfig, MountingConfig
    from starcal_ros.recording.bag import open_bag
    from starcal_ros.recording.reader import CONFIG_ATTACHMENT
    attached = open_bag(Path(bag)).attachments.get(CONFIG_ATTACHMENT)
    needed = ('--config FILE is needed: a parameter file that states camera, mounting and gyro, '
              f'written as {config_file("tan2018.yaml")} is')
    if attached is None:
        raise ConfigError(f'{bag} carries no configuration; {needed}')
    name = f'{CONFIG_ATTACHMENT} in {bag}'
    try:
        reading = parameter_file.read(attached.decode(errors='replace'), name, nodes,
                                      options.namespace)
    except ConfigError as error:
        raise ConfigError(f'{error}; --config FILE takes its place') from None
    own = reading.scenario
    if (own.camera, own.mounting) == (CameraConfig(), MountingConfig()):
        # As of a recorder that was started without a parameter file.
        raise ConfigError(f'{name} states neither camera nor mounting; {needed}')
    say(f'configuration: {name}')
    return _said(reading)


def _said(reading: parameter_file.Reading) -> Scenario:
    for text in reading.notices:
        say(f'warning: {text}')
    return reading.scenario
