# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal watch``: the running estimator in the terminal."""

from __future__ import annotations

import argparse
import os

DESCRIPTION = ('Show what the running estimator says: the verdict, each state with its sigma and '
               'tolerance, rates, counts and a map of the stars. Ctrl-C ends it.')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    parser.add_argument('--namespace', metavar='NS', help='namespace of the estimator')
    parser.add_argument('--json', action='store_true', help='print what is new, twice a second, '
                        'as a line of JSON each time')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.workflows.node_program import node_command
    command = node_command('watch', {}, namespace=options.namespace, as_json=options.json)
    os.execv(command[0], command)       # so that Ctrl-C and the status are the node's own
