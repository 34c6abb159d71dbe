# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal simulate``: a recording without ROS."""

from __future__ import annotations

import argparse
from pathlib import Path

from starcal_ros.cli import arguments, outputs
from starcal_ros.cli.terminal import progress, show_json

DESCRIPTION = ('Simulate the sensors of a scenario and write their messages, the configuration '
               'and the truth into an MCAP recording, without ROS.')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_config(parser)
    parser.add_argument('--out', metavar='BAG', required=True, help='.mcap file to write')
    arguments.add_duration(parser)
    parser.add_argument('--seed', metavar='N', type=int,
                        help='seed of the noise, in place of simulation.seed')
    outputs.add_overwrite(parser)
    arguments.add_json(parser, 'what was written')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.simulation.write_recording import simulate
    scenario = arguments.scenario(options, arguments.SIMULATORS, duration_s=options.duration,
                                  seed=options.seed)
    outputs.claim([options.out], [options.config], options.overwrite)
    with progress('simulating') as on_progress:
        simulate(scenario, options.out, options.overwrite, on_progress)
    if options.json:
        from starcal_ros.recording.bag import open_bag
        given = scenario.simulation
        show_json({'out': options.out, 'duration_s': given.duration_s, 'seed': given.seed,
                   'messages': {topic.name: topic.count
                                for topic in open_bag(Path(options.out)).topics()}})
    return 0
