# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal demo``: the whole suite as separate ROS 2 processes, live and offline."""

from __future__ import annotations

import argparse
from pathlib import Path

from starcal_ros.cli import arguments, outputs
from starcal_ros.cli.calibrate import Reports, calibrate_recording
from starcal_ros.cli.terminal import progress, show, show_json

DESCRIPTION = ('Start star tracker, gyro, estimator and recorder as separate ROS 2 processes, run '
               'a shortened scenario faster than real time, record it, calibrate the recording '
               'again and compare. Leaves run.mcap, result.json, convergence.png and report.html.')

SAME = 1e-9
"""Relative difference up to which the live and the offline estimates are the same."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    arguments.add_config(parser)
    parser.add_argument('--out', metavar='FOLDER', default='demo',
                        help='where to put the results (default: %(default)s)')
    parser.add_argument('--duration', metavar='S', type=float, default=1092.0,
                        help='simulated seconds (default: %(default)s, twice through the '
                        'rotations of tan2018.yaml)')
    parser.add_argument('--factor', metavar='N', type=float, default=0.0,
                        help='simulated seconds a second; 0 is as fast as the nodes go '
                        '(default: %(default)s)')
    arguments.add_json(parser, 'the result, and how the live estimates differ from it,')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from starcal_ros.workflows import live_run
    scenario = arguments.scenario(
        options, (*arguments.SIMULATED, 'recorder'), duration_s=options.duration,
        real_time_factor=options.factor)
    folder = Path(options.out)
    outputs.make_folder(folder)
    outputs.claim([folder / name for name in live_run.FILES], [options.config], overwrite=True)
    live_run.make_room(folder)
    with progress('live run') as on_progress:
        recording = live_run.run_live(scenario, folder, on_progress)
    calibrator, outcome = calibrate_recording(
        recording, scenario, folder / live_run.RESULT, folder / live_run.FIGURE,
        Reports([folder / live_run.REPORT], command=options.line))
    difference = live_run.compare(recording, calibrator)
    show_json({'folder': str(folder), 'files': list(live_run.FILES),
               'live_differs_by': difference, 'result': outcome})
    show(f'Live estimator and offline calibration differ by at most {difference:.1e} of the '
         'values.')
    show(f'In {folder}/: {live_run.RECORDING}, {live_run.RESULT}, {live_run.FIGURE}, '
         f'{live_run.REPORT}')
    return 0 if difference < SAME else 1
