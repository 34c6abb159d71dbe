# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal play``: a recording over ROS 2 again."""

from __future__ import annotations

import argparse
import subprocess

from starcal_ros.cli import arguments

SUMMARY = 'publish a recording again over ROS 2'
DESCRIPTION = ('Publish the sensor topics of a recording and /clock, as the node `player` does. '
               'Its services ~/pause and ~/resume stop it for a while.')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_bag(parser)
    parser.add_argument('--rate', metavar='N', type=float, default=1.0,
                        help='recorded seconds a second; 0 is as fast as the subscribers take it '
                        '(default: %(default)s)')
    parser.add_argument('--start-offset', metavar='S', type=float, default=0.0,
                        help='seconds to leave out at the beginning (default: %(default)s)')
    parser.add_argument('--loop', action='store_true', help='begin again at the end')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.workflows.live_run import node_command
    return subprocess.call(node_command('player', {
        'player.bag': str(options.bag), 'player.rate': options.rate,
        'player.start_offset_s': options.start_offset, 'player.loop': options.loop}))
