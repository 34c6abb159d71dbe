# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Several nodes of the suite in one process: `composed estimator recorder --ros-args ...`.

rclpy has no component containers. A program of your own does the same with any executor: the
node classes take what rclpy's Node takes, and none waits in a callback for another.
"""

from __future__ import annotations

from importlib import import_module
import sys

from rclpy.node import Node

from starcal_ros.nodes.base import command_line, run_loop

NODES = ('recorder', 'watch', 'serve', 'display', 'estimator', 'intrinsics_estimator',
         'star_identifier', 'centroid_extractor', 'player', 'star_tracker_sim', 'gyro_sim')
"""In the order in which they are created: who listens before who speaks, to miss nothing."""


def node_class(name: str) -> type[Node]:
    """Return the class of a node: that of star_tracker_sim is StarTrackerSim."""
    module = import_module(f'starcal_ros.nodes.{name}')
    found: type[Node] = getattr(module, ''.join(map(str.capitalize, name.split('_'))))
    return found


def main(args: list[str] | None = None) -> int:
    """Run the nodes that the command line names."""
    names = command_line.words(args)
    if command_line.asks_for_help(names):
        print(command_line.help_text(__name__, __doc__, 'NODE [NODE ...] '))
        print(f'Nodes: {", ".join(NODES)}')
        return run_loop.STATUS_OK
    wrong = [name for name in names if name not in NODES]
    if wrong or not names:
        print(f'error: got {", ".join(wrong) or "no node"}, needs one or more of '
              f'{", ".join(NODES)}', file=sys.stderr)
        return run_loop.STATUS_USAGE
    return run_loop.run_together([node_class(name) for name in NODES if name in names], args)
