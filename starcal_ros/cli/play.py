# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal play``: a recording over ROS 2 again."""

from __future__ import annotations

import argparse
import subprocess

from starcal_ros.cli import arguments

SUMMARY = 'publish a recording again over ROS 2'
DESCRIPTION = 'Publish the sensor topics of a recording, as the node `player` does.'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_bag(parser)
    parser.add_argument('--rate', metavar='N', type=float, default=1.0,
                        help='recorded seconds a second; 0 is as fast as the subscribers take it '
                        '(default: %(default)s)')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.demo import node_command
    return subprocess.call(node_command('player', {
        'player.bag': str(options.bag), 'player.rate': options.rate}))
