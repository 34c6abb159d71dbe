# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal allan``: the noise of a gyro at rest."""

from __future__ import annotations

import argparse
import json

import numpy as np

from starcal_ros.cli import arguments, outputs
from starcal_ros.cli.terminal import progress, say, show, show_json
from starcal_ros.config.parameter import ConfigError
from starcal_ros.files.output import write_text

DESCRIPTION = ('Tell the noise of a gyro from its Allan deviation: quantisation, angle random '
               'walk, bias instability and rate random walk of each axis, with their intervals, '
               'and the lines of a parameter file. Of the recording the longest stretch at rest '
               'is used. What it is too short to show is not known, and only bounded. Needs the '
               'extra allan.')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_bag(parser)
    arguments.add_gyro_topic(parser)
    parser.add_argument('--out', metavar='RESULT.json', help='curves and noise to write')
    parser.add_argument('--figure', metavar='PNG', help='draw the Allan deviation')
    outputs.add_overwrite(parser)
    arguments.add_json(parser, 'what --out writes')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    outputs.claim([options.out, options.figure], [options.bag], options.overwrite)
    from starcal_ros.measurements.allan import allan
    from starcal_ros.measurements.rest import longest_rest
    from starcal_ros.recording import reader
    from starcal_ros.report import allan as report
    with progress('reading') as on_progress:
        gyro, topic, warnings = reader.read_gyro(options.bag, on_progress, options.gyro_topic)
    rest = longest_rest(gyro)
    try:
        curves = [allan(column, rest.rate_hz)
                  for column in np.degrees(gyro.rate[rest.readings]).T * 3600.0]
    except ImportError as error:
        raise ConfigError(str(error)) from None
    notices = [*warnings, *rest.notices, *(
        f'axis {axis}: the five terms do not explain the curve; motion, vibration, or a filter in '
        'the gyro?' for axis, curve in zip('xyz', curves) if not curve.fits)]
    for text in notices:
        say(f'warning: {text}')
    lines = report.parameter_lines(curves)
    outcome = {'recording': str(options.bag), 'topic': topic, 'rate_hz': rest.rate_hz,
               'begin_s': rest.begin_s, 'end_s': rest.end_s,
               'readings': rest.readings.stop - rest.readings.start, 'warnings': notices,
               **report.noise_json(curves), 'parameters': lines}
    title = (f'{topic} of {options.bag}: {outcome["readings"]} readings at {rest.rate_hz:.2f} Hz, '
             f'{rest.begin_s:.1f} to {rest.end_s:.1f} s')
    show_json(outcome)
    show(report.noise_table(curves, title))
    show(lines)
    if options.out:
        write_text(options.out, json.dumps(outcome, indent=1, allow_nan=False) + '\n')
    if options.figure:
        report.noise_figure(curves, title, options.figure)
    return 0
