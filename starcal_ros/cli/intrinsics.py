# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal intrinsics``: the camera alone, by any method, from a recording or from images."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from starcal_ros import calibration
from starcal_ros.camera import INTRINSICS
from starcal_ros.cli import arguments
from starcal_ros.cli.terminal import progress, say, show
from starcal_ros.config import Scenario, parameters
from starcal_ros.parameter import ConfigError

SUMMARY = 'calibrate the camera alone'
DESCRIPTION = ('Calibrate the camera alone, from what the stars are to each other: no attitude is '
               'needed, and with interstar and bundle no identification. From a recording it '
               'begins at the nominal camera with estimator.initial_sigma. From a table of stars '
               '(--centroids) nothing but the size of the images need be known, and the result is '
               "OpenCV's f, u0, v0, k1, k2, p1, p2 with their covariance and the RMS of fitted "
               'and of held-out images.')

_OPTIONS = ('method', 'estimate', 'weighting', 'combination_model', 'singular_values',
            'interstar_equations')
_BATCHES = 50       # in which the frames are handed over, for the sake of the progress bar


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes: the sources, and each parameter of the group ``intrinsics``."""
    parser.add_argument('bag', metavar='BAG', nargs='?', help='.mcap file or rosbag2 directory')
    arguments.add_config(parser)
    parser.add_argument('--out', metavar='RESULT.json', help='result to write')
    choices = {'method': calibration.names(), 'estimate': list(INTRINSICS)}
    for name in _OPTIONS:
        parameter = parameters()[f'intrinsics.{name}']
        listed = choices.get(name) or list(parameter.spec.choices)
        allowed = f' ({", ".join(listed)})' if listed else ''
        parser.add_argument(
            '--' + name.replace('_', '-'), type=parameter.element, dest=name,
            nargs='+' if parameter.is_array else None, metavar=name.upper(),
            help=f'{parameter.spec.text}{allowed}; default: intrinsics.{name}')
    parser.add_argument('--report', metavar='HTML',
                        help='write the report of a camera from images, on one page')
    images = parser.add_argument_group('images in place of a recording')
    images.add_argument('--centroids', metavar='STARS.csv',
                        help='identified stars: image, u, v, catalog_id, optionally split '
                        '(fit or heldout)')
    images.add_argument('--width', metavar='PX', type=int, help='of the images')
    images.add_argument('--height', metavar='PX', type=int, help='of the images')
    images.add_argument('--fov', metavar='DEG', type=float,
                        help='field of view across the width; default: found from the stars')
    images.add_argument('--epoch', metavar='TIME', default='2020-01-01T00:00:00',
                        help='when they were taken, ISO 8601, for the proper motions '
                        '(default: %(default)s)')
    images.add_argument('--aberration', action='store_true',
                        help='count the aberration of an observer on the Earth at --epoch')


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    if bool(options.bag) == bool(options.centroids):
        raise ConfigError('intrinsics: needs either BAG or --centroids STARS.csv')
    if options.bag and options.report:
        raise ConfigError('--report: is for images; starcal calibrate reports on a recording')
    for path in (options.out, options.report):
        if path:
            arguments.require_writable(Path(path))
    outcome = _of_recording(options) if options.bag else _of_plates(options)
    if options.out:
        from starcal_ros import result
        result.write_json(options.out, outcome)
    return 0


def _given(options: argparse.Namespace) -> dict[str, Any]:
    """Return the parameters of the group ``intrinsics`` that the command line states."""
    return {f'intrinsics.{name}': getattr(options, name) for name in _OPTIONS
            if getattr(options, name) is not None}


def _of_recording(options: argparse.Namespace) -> dict[str, Any]:
    scenario = arguments.scenario(options).replace(_given(options))
    method = calibration.start(scenario)
    from starcal_ros import record, report, result
    with progress('reading') as on_progress:
        recording = record.read(options.bag, on_progress, needs_gyro=False)
    frames = recording.frames
    with progress('calibrating') as on_progress:
        method.add_gyro(recording.gyro)
        for part in range(_BATCHES):
            low, high = (len(frames) * k // _BATCHES for k in (part, part + 1))
            method.add_frames(frames[low:high])
            on_progress((part + 1) / (_BATCHES + 1))
        estimate = method.estimate()
        on_progress(1.0)
    for text in (*recording.warnings, *method.take_notices()):
        say(f'warning: {text}')
    if estimate is None:
        raise result.CalibrationError(
            f'no camera from {len(frames)} frames with {len(frames.catalog_id)} stars, '
            f'{(frames.catalog_id > 0).sum()} of them identified')
    outcome = {'method': scenario.intrinsics.method, **result.camera(estimate),
               'provenance': result.provenance(scenario, recording)}
    attached = recording.attachments.get(record.TRUTH_ATTACHMENT)
    truth = json.loads(attached) if attached else None
    show(report.camera(outcome, truth, f'Camera of {options.bag}, {scenario.intrinsics.method}'))
    return outcome


def _of_plates(options: argparse.Namespace) -> dict[str, Any]:
    from starcal_ros import plates, report, result
    if not (options.width and options.height):
        raise ConfigError('--centroids: needs --width and --height of the images')
    images = plates.read_centroids(options.centroids, options.epoch)
    f_px = (plates.focal_length_of_field(options.fov, options.width) if options.fov
            else plates.focal_length_px(images, options.width, options.height))
    scenario = _plate_scenario(options, f_px)
    with progress('calibrating') as on_progress:
        found = plates.calibrate(images, scenario)
        on_progress(1.0)
    if found is None:
        raise result.CalibrationError(
            f'{options.centroids}: no camera from {len(images.names)} images with '
            f'{len(images.frames.catalog_id)} stars')
    outcome = {'method': scenario.intrinsics.method, 'source': options.centroids,
               **found.as_dict()}
    show(report.plates(outcome, f'Camera of {options.centroids}, {outcome["method"]}'))
    if options.report:
        from starcal_ros.report.plate_page import write_plate_page
        write_plate_page(options.report, found, outcome, [])
    return outcome


def _plate_scenario(options: argparse.Namespace, f_px: float) -> Scenario:
    from starcal_ros import plates
    method = options.method or 'bundle'
    velocity = 'geocentre' if options.aberration else 'barycentre'
    scenario = plates.scenario_of(options.width, options.height, f_px, method, velocity)
    return scenario.replace(_given(options))
