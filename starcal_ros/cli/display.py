# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal display``: what other viewers draw of a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from starcal_ros.cli import arguments, outputs
from starcal_ros.cli.terminal import progress, show, show_json

DESCRIPTION = ('Write stars and residuals of a recording as markers and as annotations of images, '
               'and verdict, sigmas and tolerances as plain numbers, into a recording of its own, '
               'to be opened together with it in Foxglove, Lichtblick, RViz, PlotJuggler. Live, '
               'the node display publishes the same.')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_bag(parser)
    parser.add_argument('--out', metavar='FILE', required=True, help='.mcap file to make')
    parser.add_argument('--namespace', metavar='NS', help='namespace of the estimator')
    outputs.add_overwrite(parser)
    arguments.add_json(parser, 'how many frames it has')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.live.drawn import draw
    outputs.claim([options.out], [options.bag], options.overwrite)
    with progress('drawing') as on_progress:
        frames = draw(Path(options.bag), Path(options.out), options.namespace, options.overwrite,
                      on_progress)
    show(f'{frames} frames in {options.out}')
    show_json({'recording': str(options.bag), 'out': str(options.out), 'frames': frames})
    return 0
