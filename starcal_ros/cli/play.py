# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal play``: a recording over ROS 2 again."""

from __future__ import annotations

import argparse
from pathlib import Path
import subprocess

from starcal_ros.cli import arguments
from starcal_ros.messages.topics import TOPICS
from starcal_ros.recording.topic_choice import FRAMES, GYRO, IMAGE, choose, of_type

DESCRIPTION = ('Publish the sensor topics of a recording and /clock, as the node `player` does. '
               'Its services ~/pause and ~/resume stop it for a while.')

_NOT_PLAYED = (*(topic.recorded for topic in TOPICS if topic.result), '/rosout',
               '/parameter_events', '/clock')       # as the player leaves them out


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_bag(parser)
    arguments.add_topics(parser)
    parser.add_argument('--rate', metavar='N', type=float, default=1.0,
                        help='recorded seconds a second; 0 is as fast as the subscribers take it '
                        '(default: %(default)s)')
    parser.add_argument('--start-offset', metavar='S', type=float, default=0.0,
                        help='seconds to leave out at the beginning (default: %(default)s)')
    parser.add_argument('--loop', action='store_true', help='begin again at the end')
    arguments.add_json(parser, 'how many messages were played, by topic,')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.workflows.node_program import node_command
    return subprocess.call(node_command('player', {
        'player.bag': str(options.bag), 'player.rate': options.rate,
        'player.start_offset_s': options.start_offset, 'player.loop': options.loop,
        **_topics(options)}, as_json=options.json))


def _topics(options: argparse.Namespace) -> dict[str, list[str]]:
    """Return the parameter that leaves out the sensors which were not chosen."""
    from starcal_ros.recording.bag import open_bag
    bag, path = open_bag(Path(options.bag)), Path(options.bag)
    topics = bag.topics()
    left_out: set[str] = set()
    for role, given in zip((GYRO, FRAMES, IMAGE), arguments.topics(options)):
        if given:
            chosen = choose(bag, role, path, given)
            left_out |= {topic.name for topic in of_type(topics, role)} - {chosen.name}
    if not left_out:
        return {}
    return {'player.topics': [topic.name for topic in topics if topic.name not in left_out
                              and not topic.name.endswith(_NOT_PLAYED)]}
