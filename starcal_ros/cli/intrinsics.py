# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal intrinsics``: the camera alone, by any method."""

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

SUMMARY = 'calibrate the camera of a recording'
DESCRIPTION = ('Calibrate the camera alone, from what the stars are to each other: no attitude is '
               'needed, and with interstar and bundle no identification. Gyro readings help them '
               'to follow the stars, where there are any. Begins at the nominal camera with '
               'estimator.initial_sigma.')

_OPTIONS = ('method', 'estimate', 'weighting', 'combination_model', 'singular_values',
            'interstar_equations')
_BATCHES = 50       # in which the frames are handed over, for the sake of the progress bar


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes: each parameter of the group ``intrinsics``."""
    arguments.add_bag(parser)
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


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    scenario = _scenario(options)
    method = calibration.start(scenario)
    out = Path(options.out) if options.out else None
    if out is not None:
        arguments.require_writable(out)
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
    outcome: dict[str, Any] = {'method': scenario.intrinsics.method, **result.camera(estimate),
                               'provenance': result.provenance(scenario, recording)}
    if out is not None:
        result.write_json(out, outcome)
    attached = recording.attachments.get(record.TRUTH_ATTACHMENT)
    truth = json.loads(attached) if attached else None
    show(report.camera(outcome, truth, f'Camera of {options.bag}, {scenario.intrinsics.method}'))
    return 0


def _scenario(options: argparse.Namespace) -> Scenario:
    given = {f'intrinsics.{name}': getattr(options, name) for name in _OPTIONS
             if getattr(options, name) is not None}
    return arguments.scenario(options).replace(given)
