# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal intrinsics``: the camera alone, by any method, from a recording or from images."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starcal_ros import calibration
from starcal_ros.cli import arguments, outputs, still_images
from starcal_ros.cli.terminal import STATUS, progress, say, show, show_json
from starcal_ros.config.models import detector
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario, parameters
from starcal_ros.core.camera import INTRINSICS
from starcal_ros.files.output import write_text
from starcal_ros.imaging.files import KINDS, is_image

if TYPE_CHECKING:
    from starcal_ros.measurements.samples import Frames
    from starcal_ros.recording.reader import Recording

DESCRIPTION = ('Calibrate the camera alone, from what the stars are to each other: no attitude is '
               'needed, and with interstar and bundle no identification. From a recording it '
               'begins at the nominal camera with estimator.initial_sigma. Of a folder of images '
               f'({KINDS}) nothing need be known: their stars are measured and '
               "identified (extra identify), and the result is OpenCV's f, u0, v0, k1, k2, p1, p2 "
               'with their covariance and the RMS of fitted and of held-out images. A table of '
               'identified stars (--centroids) does as well. The residuals are tested: exit '
               'status 0 means consistent, 3 that it is not enough yet, 4 that the data '
               'contradict the camera.')

_OPTIONS = ('method', 'estimate', 'free', 'weighting', 'combination_model', 'singular_values',
            'interstar_equations')
_NODES = ('intrinsics_estimator', 'centroid_extractor')
_BATCHES = 50       # in which the frames are handed over, for the sake of the progress bar


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes: the sources, and each parameter of the group ``intrinsics``."""
    parser.add_argument('source', metavar='BAG|IMAGES', nargs='?',
                        help='.mcap file or rosbag2 directory, or a folder of images of the sky; '
                        'a recording of images alone, without --config, is taken as such a folder')
    arguments.add_config(parser, recorded=True)
    arguments.add_topics(parser)
    parser.add_argument('--out', metavar='RESULT.json', help='result to write')
    parser.add_argument('--export', metavar='FOLDER',
                        help='write the camera for other programs: camera_info.yaml, '
                        'camchain.yaml (Kalibr), opencv.yaml, cameras.txt (COLMAP); of still '
                        'images their attitudes, too: images.txt (COLMAP), and a FITS WCS with '
                        'SIP of each in wcs/')
    outputs.add_overwrite(parser)
    arguments.add_json(parser, 'what --out writes')
    choices = {'method': calibration.names(), 'estimate': list(INTRINSICS)}
    for name in _OPTIONS:
        parameter = parameters()[f'intrinsics.{name}']
        listed = choices.get(name) or list(parameter.spec.choices)
        allowed = f' ({", ".join(listed)})' if listed else ''
        parser.add_argument(
            '--' + name.replace('_', '-'), type=parameter.element, dest=name,
            nargs='+' if parameter.is_array else None, metavar=name.upper(),
            help=f'{parameter.spec.text}{allowed}; default: intrinsics.{name}')
    still_images.add_arguments(parser)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    if bool(options.source) == bool(options.centroids):
        raise ConfigError('needs a recording, a folder of images, or --centroids STARS.csv')
    recording = not options.centroids and _is_recording(Path(options.source))
    if recording and not options.config:
        from starcal_ros.recording import stills
        if stills.are_all(options.source):
            recording = False           # as a folder of them
    still_images.refuse_unused(options, recording)
    outputs.claim([options.out, *outputs.reports(options), options.stars,
                   *_exported(options.export)],
                  [options.source, options.centroids, options.config], options.overwrite)
    outputs.check_reports(options)
    outcome = (_of_recording(options) if recording
               else still_images.run(options, _given(options)))
    if options.out:
        from starcal_ros.results import document
        document.write_json(options.out, outcome)
    show_json(outcome)
    return max(STATUS[each['verdict']] for each in (outcome, *outcome.get('other_cameras', ())))


def _exported(folder: str | None) -> list[Path]:
    """Return the files that are exported to a folder, which is made."""
    if folder is None:
        return []
    from starcal_ros.results import camera_files
    from starcal_ros.workflows.still_images import export
    path = Path(folder)
    outputs.make_folder(path)
    return [*(path / name for name in (*camera_files.NAMES, export.IMAGES)),
            *(path / export.WCS_FOLDER).glob('*.wcs')]


def _is_recording(path: Path) -> bool:
    """Tell a recording from a folder of images."""
    if path.is_file() and not is_image(path):
        return True
    names = [file.name for file in path.iterdir()] if path.is_dir() else []
    if 'metadata.yaml' in names or any(
            name.endswith(('.mcap', '.db3', '.mcap.zstd', '.db3.zstd', '.bag')) for name in names):
        return True
    if any(is_image(name) for name in names):
        return False
    what = ('is one image' if path.is_file() else
            'holds no recording and no image' if path.is_dir() else 'does not exist')
    raise ConfigError(f'{path} {what}; needs an .mcap file, a rosbag2 directory, or a folder of '
                      f'images ({KINDS})')


def _given(options: argparse.Namespace) -> dict[str, Any]:
    """Return the parameters of the group ``intrinsics`` that the command line states."""
    return {f'intrinsics.{name}': getattr(options, name) for name in _OPTIONS
            if getattr(options, name) is not None}


def _of_recording(options: argparse.Namespace) -> dict[str, Any]:
    scenario = arguments.scenario_of(options.source, options, _NODES).replace(_given(options))
    calibration.start(scenario)             # says what is wrong before the reading
    from starcal_ros import report
    from starcal_ros.recording import reader
    from starcal_ros.recording.measured_images import ImageMeter, as_measured, as_still
    from starcal_ros.results import result
    from starcal_ros.results.attached_truth import attached_truth
    from starcal_ros.results.document import CalibrationError
    with progress('reading') as on_progress:
        recording = reader.read(options.source, on_progress, needs_gyro=False,
                                measure=ImageMeter(scenario), choice=arguments.topics(options))
    frames, notices = recording.frames, recording.warnings
    if recording.measured:
        scenario = as_measured(scenario)
        frames, said = _identified(recording, scenario)
        frames, notices = as_still(frames), (*notices, *said)
    method = calibration.start(scenario)
    with progress('calibrating') as on_progress:
        method.add_gyro(recording.gyro)
        for part in range(_BATCHES):
            low, high = (len(frames) * k // _BATCHES for k in (part, part + 1))
            method.add_frames(frames[low:high])
            on_progress((part + 1) / (_BATCHES + 1))
        estimate = method.estimate()
        judged = None if estimate is None else method.judge(estimate)
        on_progress(1.0)
    for text in (*notices, *method.take_notices()):
        say(f'warning: {text}')
    if estimate is None or judged is None:
        raise CalibrationError(
            f'no camera from {len(frames)} frames with {len(frames.catalog_id)} stars, '
            f'{(frames.catalog_id > 0).sum()} of them identified')
    outcome = {'method': scenario.intrinsics.method, **result.camera(estimate),
               'detector': result.of_detector(detector(scenario.camera)),
               **judged.as_dict(), 'residual_trends': method.trends(estimate),
               'provenance': result.provenance(scenario, recording)}
    truth, doubts = attached_truth(recording.attachments)
    for text in doubts:
        say(f'warning: {text}')
    show(report.camera(outcome, truth, f'Camera of {options.source}, {outcome["method"]}'))
    show('\n'.join(report.verdict_lines(outcome)))
    if options.export:
        from starcal_ros.results import camera_files
        from starcal_ros.results.camera_files.foreign_camera import ForeignCamera
        texts, _ = camera_files.files(ForeignCamera.of_intrinsics(
            estimate.intrinsics, detector(scenario.camera)))
        for name, text in texts.items():
            write_text(Path(options.export) / name, text)
    return outcome


def _identified(recording: Recording, scenario: Scenario) -> tuple[Frames, tuple[str, ...]]:
    """Return frames that were measured with the numbers of their stars, and what to say."""
    from starcal_ros.identification import recorded
    from starcal_ros.measurements.message_source import InMemory
    try:
        with progress('identifying') as on_progress:
            return recorded.identify(InMemory(recording.gyro, recording.frames), scenario,
                                     on_progress)
    except ImportError as error:
        return recording.frames, (f'the stars of the images have no numbers: {error}',)
