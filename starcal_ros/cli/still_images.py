# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Still images for ``starcal intrinsics``: a folder of them, or a table of their stars."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from datetime import timedelta, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starcal_ros.cli import outputs
from starcal_ros.cli.terminal import progress, say, show
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import stamp_ns
from starcal_ros.core.lenses import NAMES, PLUMB_BOB
from starcal_ros.files.output import same

if TYPE_CHECKING:
    from starcal_ros.report.annotated import Annotated
    from starcal_ros.sky.refraction import Site
    from starcal_ros.workflows.still_images.measured import Measured
    from starcal_ros.workflows.still_images.pipeline import Calibrated, Conditions, Source

_LENSES = (*NAMES, 'auto')
_OF_TABLE = ('width', 'height')
_OF_FOLDER = ('heldout', 'saturation', 'mask', 'stars', 'annotate', 'utc_offset')
_OF_BOTH = ('lens', 'pixel_phase', 'fov', 'epoch', 'aberration', 'site', 'pressure',
            'temperature', 'report', 'light_report')
_OF_FILE = 'the parameter file of a recording has '
_IN_RECORDINGS = {
    'report': 'starcal calibrate reports on a recording',
    'light_report': 'starcal calibrate reports on a recording',
    'pixel_phase': 'starcal calibrate estimates it with estimator.augment.pixel_phase_sigma_px',
    'aberration': _OF_FILE + 'observer.velocity', 'site': _OF_FILE + 'observer.site_deg',
    'pressure': _OF_FILE + 'observer.site_pressure_hpa',
    'temperature': _OF_FILE + 'observer.site_temperature_c',
    'saturation': _OF_FILE + 'image.centroid.saturation_counts'}
"""What there is instead for a recording with a parameter file."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what still images need."""
    images = parser.add_argument_group(
        'still images, in a folder or in a table', 'The default of --method is bundle.')
    images.add_argument('--fov', metavar='DEG', type=float,
                        help='field of view across the width, for IMAGES to 10 %%, beyond 120 '
                        'deg that of a fisheye; default: found from the file (EXIF, FITS), or '
                        'from the stars (1 to 105 deg, and fisheyes)')
    images.add_argument('--lens', choices=_LENSES, metavar='NAME',
                        help=f'lens model of the method bundle ({", ".join(_LENSES)}); auto: that '
                        'which predicts stars best; default: plumb_bob')
    images.add_argument('--pixel-phase', action='store_true',
                        help='estimate how centroids depend on where in a pixel a star falls, too '
                        '(method bundle)')
    images.add_argument('--epoch', metavar='TIME',
                        help='when they were taken, ISO 8601, UTC, whatever their files say '
                        '(DATE-OBS of FITS, EXIF); where neither tells: 2020, for the proper '
                        'motions')
    images.add_argument('--aberration', action='store_true',
                        help='count the aberration of an observer on the Earth at that time')
    images.add_argument('--site', metavar='LAT,LON[,HEIGHT]',
                        help='where they were taken, deg north, deg east, m above the sea: counts '
                        'refraction, and aberration; needs the times of the images '
                        '(south or west of 0: --site=-33.4,-70.7)')
    images.add_argument('--pressure', metavar='HPA', type=float,
                        help='of the air there; default: that of the standard atmosphere')
    images.add_argument('--temperature', metavar='C', type=float,
                        help='of the air there, likewise')
    outputs.add_report(images)
    folder = parser.add_argument_group('IMAGES, a folder')
    folder.add_argument('--heldout', metavar='K', type=int,
                        help='hold out every K-th image: it judges the camera and takes no part')
    folder.add_argument('--saturation', metavar='COUNTS', type=float,
                        help='counts from which a pixel is saturated; default: SATURATE of FITS, '
                        'else the top of the type of the file')
    folder.add_argument('--utc-offset', metavar='HOURS', type=float,
                        help='of the clock of the camera, whatever the files say: '
                        '--utc-offset=-7 for UTC-7; default: what they say, else UTC')
    folder.add_argument('--mask', metavar='IMAGE',
                        help='image of the same size, black where nothing is to be looked for: '
                        'trees, a horizon, text')
    folder.add_argument('--stars', metavar='STARS.csv',
                        help='write the stars that were found, for --centroids')
    folder.add_argument('--annotate', metavar='DIR',
                        help='draw each image with its spots, its stars and their names, those '
                        'that the fit refuses and a grid; or with why it is left out')
    table = parser.add_argument_group('--centroids, a table of identified stars')
    table.add_argument('--centroids', metavar='STARS.csv',
                       help='image, u, v, catalog_id, optionally sigma and split (fit or heldout)')
    table.add_argument('--width', metavar='PX', type=int, help='of the images')
    table.add_argument('--height', metavar='PX', type=int, help='of the images')


def refuse_unused(options: argparse.Namespace, recording: bool) -> None:
    """Name an option that would be passed over.

    Raises
    ------
    ConfigError
        Where there is one.
    """
    def given(names: tuple[str, ...]) -> list[str]:
        return [name for name in names if getattr(options, name) not in (None, False, [])]

    if recording:
        for name in given((*_OF_BOTH, *_OF_FOLDER, *_OF_TABLE)):
            shown = name.replace('_', '-')
            instead = _IN_RECORDINGS.get(name)
            raise ConfigError(f'--{shown}: is for still images, {options.source} is a recording'
                              + (f'; {instead}' if instead else ''))
        return
    for name in given(_OF_FOLDER if options.centroids else _OF_TABLE):
        raise ConfigError(f'--{name.replace("_", "-")}: is for '
                          + ('a folder of images' if options.centroids else
                             '--centroids; images have a size of their own'))
    for name in given(('config', 'namespace', 'gyro_topic', 'frames_topic', 'image_topic')):
        raise ConfigError(f'--{name.replace("_", "-")}: is for a recording')
    for name in given(('pressure', 'temperature')):
        if not options.site:
            raise ConfigError(f'--{name}: needs --site')
    if options.epoch:
        stamp_ns('--epoch', options.epoch)
    if options.utc_offset is not None and not abs(options.utc_offset) <= 14.0:
        raise ConfigError(f'--utc-offset: got {options.utc_offset:g}, needs -14 to 14 h')
    if options.annotate:
        _claim_folder(Path(options.annotate), Path(options.source), options.overwrite)
    if options.heldout is not None and options.heldout < 2:
        raise ConfigError(f'--heldout: got {options.heldout}, needs 2 or more')
    if options.saturation is not None and not options.saturation > 0.0:
        raise ConfigError(f'--saturation: got {options.saturation:g}, needs more than 0')


def _claim_folder(folder: Path, source: Path, overwrite: bool) -> None:
    """Make the folder of ``--annotate``, which holds nothing that is read or would be lost."""
    outputs.make_folder(folder)
    if same(folder, source):
        raise ConfigError(f'--annotate: {folder} holds the images: choose another folder')
    if any(folder.iterdir()) and not overwrite:
        raise ConfigError(f'--annotate: {folder} is not empty; choose another folder, or write '
                          'into it with --overwrite')


def run(options: argparse.Namespace, given: dict[str, Any]) -> dict[str, Any]:
    """Calibrate and show a camera.

    Parameters
    ----------
    options : Namespace
        Of `add_arguments`, with ``source``, a folder of images where there is no table.
    given : dict
        Parameters that the command line states.

    Returns
    -------
    outcome : dict
        What is written as JSON.
    """
    from starcal_ros.workflows.still_images import pipeline
    from starcal_ros.workflows.still_images.said import by_text
    conditions = pipeline.Conditions(options.fov, options.epoch, _site(options),
                                     options.aberration,
                                     None if options.utc_offset is None else timezone(
                                         timedelta(hours=options.utc_offset)))
    source = _of_table(options, conditions) if options.centroids else _of_folder(
        options, conditions)
    for text in (*source.notices, *(f'{names} left out: {why}'
                                    for names, why in by_text(source.left_out.items()))):
        say(f'warning: {text}')
    with progress('calibrating') as on_progress:
        first = pipeline.calibrate(source, parameters=given, lens=_lens(options),
                                   phase=options.pixel_phase)
        on_progress(1.0)
    found, outcome = first
    _show(source, outcome, bool(source.others))
    others = [each for other in source.others
              if (each := _other(other, given, options)) is not None]
    if source.others:
        outcome['other_cameras'] = [each.outcome for each in others]
    if options.export:
        from starcal_ros.workflows.still_images import export
        for text in export.write(options.export, source, found):
            say(f'warning: {text}')
    drawn = _drawn(options, source.measured, (first, *others), source.left_out)
    if options.report or options.light_report:
        from starcal_ros.report import write
        from starcal_ros.report.still_images_page import still_images_page
        doubts = [*filter(None, [outcome.get('air', {}).get('doubt')])]
        write.write(still_images_page(found, outcome, [*source.notices, *doubts], options.line,
                                      drawn), options.report, options.light_report)
    return outcome


def _lens(options: argparse.Namespace) -> str:
    return options.lens or PLUMB_BOB


def _drawn(options: argparse.Namespace, images: Sequence[Measured],
           cameras: Sequence[Calibrated], left_out: Mapping[str, str]) -> list[Annotated]:
    """Draw images, into the folder of ``--annotate``; return those that the report shows."""
    if not images or not (options.annotate or options.report or options.light_report):
        return []
    from starcal_ros.files.output import whole
    from starcal_ros.report.annotated import annotate, skies
    from starcal_ros.report.still_images_page import shown
    known = {name: sky for found, outcome in cameras
             for name, sky in skies(found, outcome['flipped']).items()}
    kept = (shown([image.name for image in images], left_out)
            if options.report or options.light_report else set())
    drawn = []
    with progress('drawing') as on_progress:
        for k, each in enumerate(annotate(images, known, left_out)):
            if options.annotate:
                with whole(Path(options.annotate) / f'{each.name}.jpg') as draft:
                    draft.write_bytes(each.jpeg())
            if each.name in kept:
                drawn.append(each)
            on_progress((k + 1) / len(images))
    return drawn


def _other(source: Source, given: dict[str, Any], options: argparse.Namespace
           ) -> Calibrated | None:
    """Calibrate and show another camera of the folder; None where that is not possible."""
    from starcal_ros.results.document import CalibrationError
    from starcal_ros.workflows.still_images import pipeline
    for text in source.notices:
        say(f'warning: {text}')
    try:
        calibrated = pipeline.calibrate(source, parameters=given, lens=_lens(options),
                                        phase=options.pixel_phase)
    except CalibrationError as error:
        say(f'warning: {source.label}: {error}')
        return None
    _show(source, calibrated.outcome, True)
    return calibrated


def _show(source: Source, outcome: dict[str, Any], one_of_several: bool) -> None:
    from starcal_ros import report
    if doubt := outcome.get('air', {}).get('doubt'):
        say(f'warning: {doubt}')
    show(report.still_images(outcome, f'Camera of {source.name}, {outcome["method"]}'
                             + (f': {source.label}' if one_of_several else '')))
    show('\n'.join(report.verdict_lines(outcome)))


def _of_table(options: argparse.Namespace, conditions: Conditions) -> Source:
    from starcal_ros.workflows.still_images import pipeline
    if not (options.width and options.height):
        raise ConfigError('--centroids: needs --width and --height of the images')
    if conditions.site is not None and not options.epoch:
        raise ConfigError('--site: needs --epoch, the time of the images')
    return pipeline.of_table(options.centroids, options.width, options.height, conditions)


def _of_folder(options: argparse.Namespace, conditions: Conditions) -> Source:
    from starcal_ros.workflows.still_images import pipeline
    from starcal_ros.workflows.still_images.folder import NoStarsError
    with progress('reading') as on_progress:
        try:
            return pipeline.of_folder(options.source, conditions, options.heldout,
                                      options.saturation, options.stars, options.mask, on_progress)
        except ImportError as error:
            raise ConfigError(str(error)) from None
        except NoStarsError as error:
            options.report = None
            _drawn(options, error.measured, (), error.left_out)
            raise


def _site(options: argparse.Namespace) -> Site | None:
    if not options.site:
        return None
    from starcal_ros.sky.refraction import Site
    try:
        numbers = [float(word) for word in options.site.split(',')]
        if not 2 <= len(numbers) <= 3:
            raise ValueError(f'{len(numbers)} numbers')
    except ValueError:
        raise ConfigError(f'--site: got {options.site!r}, needs LAT,LON or LAT,LON,HEIGHT, such '
                          'as 47.4,8.5,500') from None
    try:
        return Site(numbers[0], numbers[1], numbers[2] if numbers[2:] else 0.0,
                    options.pressure, options.temperature)
    except ValueError as error:
        raise ConfigError(f'--site, --pressure, --temperature: {error}') from None
