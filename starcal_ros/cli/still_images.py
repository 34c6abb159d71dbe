# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Still images for ``starcal intrinsics``: a folder of them, or a table of their stars."""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

from starcal_ros.cli import arguments
from starcal_ros.cli.terminal import progress, say, show
from starcal_ros.config.image import CentroidConfig
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import stamp_ns
from starcal_ros.sky.refraction import Site

EPOCH = '2020-01-01T00:00:00'
"""Time of images of which none is known: a few years move no star by a hundredth of a pixel."""

_UNFIT = {'interstar': '; on still images interstar needs --interstar-equations TCOC or TCWC',
          'predicted_centroid': '; predicted_centroid needs a gyro'}
_OF_TABLE = ('width', 'height')
_OF_FOLDER = ('heldout', 'saturation', 'stars')
_OF_BOTH = ('fov', 'epoch', 'aberration', 'site', 'pressure', 'temperature', 'report')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what still images need."""
    images = parser.add_argument_group(
        'still images, in a folder or in a table', 'The default of --method is bundle.')
    images.add_argument('--fov', metavar='DEG', type=float,
                        help='field of view across the width, for IMAGES to 10 %%; default: found '
                        'from the stars (IMAGES: 8 to 40 deg)')
    images.add_argument('--epoch', metavar='TIME',
                        help='when they were taken, ISO 8601, UTC, where the file of an image '
                        'does not say it (DATE-OBS of FITS, EXIF); default: 2020, for the proper '
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
    images.add_argument('--report', metavar='HTML', help='report to write, one page')
    folder = parser.add_argument_group('IMAGES, a folder')
    folder.add_argument('--heldout', metavar='K', type=int,
                        help='hold out every K-th image: it judges the camera and takes no part')
    folder.add_argument('--saturation', metavar='COUNTS', type=float,
                        help='counts from which a pixel is saturated; default: SATURATE of FITS, '
                        'else the top of the type of the file')
    folder.add_argument('--stars', metavar='STARS.csv',
                        help='write the stars that were found, for --centroids')
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
        return [name for name in names if getattr(options, name) not in (None, False)]

    if recording:
        for name in given((*_OF_BOTH, *_OF_FOLDER, *_OF_TABLE)):
            raise ConfigError(f'--{name}: is for still images, {options.source} is a recording'
                              + ('; starcal calibrate reports on a recording'
                                 if name == 'report' else ''))
        return
    for name in given(_OF_FOLDER if options.centroids else _OF_TABLE):
        raise ConfigError(f'--{name}: is for '
                          + ('a folder of images' if options.centroids else
                             '--centroids; images have a size of their own'))
    if options.config:
        raise ConfigError('--config: is for a recording')
    for name in given(('pressure', 'temperature')):
        if not options.site:
            raise ConfigError(f'--{name}: needs --site')
    if options.epoch:
        stamp_ns('--epoch', options.epoch)
    if options.heldout is not None and options.heldout < 2:
        raise ConfigError(f'--heldout: got {options.heldout}, needs 2 or more')
    if options.saturation is not None and not options.saturation > 0.0:
        raise ConfigError(f'--saturation: got {options.saturation:g}, needs more than 0')


class _Source(NamedTuple):
    """Stars in images, the size of these, where to begin, and what to add to the result."""

    images: Any
    width: int
    height: int
    focal_length_px: float
    told: dict[str, Any]


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
    from starcal_ros import report
    from starcal_ros.results import result
    from starcal_ros.workflows.still_images import calibration
    site = _site(options)
    where = options.centroids or options.source
    read = _of_table if options.centroids else _of_folder
    source = read(options, site)
    velocity = 'geocentre' if options.aberration or site else 'barycentre'
    scenario = calibration.scenario_of(source.width, source.height, source.focal_length_px,
                                       options.method or 'bundle', velocity).replace(given)
    images, notices = source.images, []
    if site is not None:
        from starcal_ros.workflows.still_images.atmosphere import without_low_stars
        frames, sunk, low = without_low_stars(images.frames, scenario, site)
        if sunk.any():
            raise ConfigError(f'--site: {sunk.sum()} of {len(sunk)} images, such as '
                              f'{images.names[int(sunk.argmax())]}, show stars below the horizon: '
                              'site or times are wrong')
        images = replace(images, frames=frames)
        if low:
            notices.append(f'{low} stars lower than 5 deg are left out')
    notices += source.told.pop('notices')
    for text in (*notices, *(f'{name} left out: {why}'
                             for name, why in source.told['left_out'].items())):
        say(f'warning: {text}')
    with progress('calibrating') as on_progress:
        found = calibration.calibrate(images, scenario, site)
        on_progress(1.0)
    if found is None:
        raise result.CalibrationError(
            f'{where}: no camera from {len(images.names)} images with '
            f'{len(images.frames.catalog_id)} stars' + _UNFIT.get(scenario.intrinsics.method, ''))
    outcome = {'method': scenario.intrinsics.method, 'source': str(where), **found.as_dict(),
               **source.told}
    if site is not None:
        outcome['air'] = {'site': [site.latitude_deg, site.longitude_deg, site.height_m],
                          **dict(zip(('pressure_hpa', 'temperature_c'), site.air))}
    show(report.still_images(outcome, f'Camera of {where}, {outcome["method"]}'))
    if options.report:
        from starcal_ros.report.plate_page import write_plate_page
        write_plate_page(options.report, found, outcome, notices)
    return outcome


def _of_table(options: argparse.Namespace, site: Site | None) -> _Source:
    from starcal_ros.workflows.still_images import calibration, opencv_camera, table
    if not (options.width and options.height):
        raise ConfigError('--centroids: needs --width and --height of the images')
    if site is not None and not options.epoch:
        raise ConfigError('--site: needs --epoch, the time of the images')
    images = table.read_centroids(options.centroids, options.epoch or EPOCH)
    f_px = (opencv_camera.focal_length_of_field(options.fov, options.width) if options.fov
            else calibration.focal_length_px(images, options.width, options.height))
    return _Source(images, options.width, options.height, f_px, {'left_out': {}, 'notices': []})


def _of_folder(options: argparse.Namespace, site: Site | None) -> _Source:
    from starcal_ros.results.result import CalibrationError
    from starcal_ros.sky.apparent import Observer
    from starcal_ros.workflows.still_images import folder, table
    if options.stars:
        arguments.require_writable(Path(options.stars))
    velocity = 'geocentre' if options.aberration or site else 'barycentre'
    with progress('reading') as on_progress:
        try:
            found = folder.read(
                options.source, options.fov, options.epoch,
                CentroidConfig(saturation_counts=options.saturation), Observer(velocity), site,
                on_progress)
        except ImportError as error:
            raise ConfigError(str(error)) from None
    left_out, images = dict(found.left_out), list(found.images)
    if site is not None:
        left_out |= {image.name: '--site needs a time, which neither the file nor --epoch tells'
                     for image in images if image.stamp_ns is None}
        images = [image for image in images if image.stamp_ns is not None]
    if not images:
        name, why = next(iter(left_out.items()))
        raise CalibrationError(f'{options.source}: no image can be used; {name}: {why}')
    notices = []
    if found.flipped:
        notices.append('the images show the sky in the mirror: they were flipped, top to bottom, '
                       'and v0, p1 are those of the flipped images')
    unsure = [image.name for image in images if not image.has_zone]
    if site is not None and unsure:
        notices.append(f'{", ".join(unsure[:3])}{" ..." * (len(unsure) > 3)}: a time without a '
                       'zone or without a time of the day is taken as UTC')
    every = options.heldout
    heldout = [bool(every) and k % every == every - 1 for k in range(len(images))]
    if options.stars:
        folder.write_table(options.stars, images, heldout)
    stars = table.assemble(
        [image.name for image in images], [image.uv_raster for image in images],
        [image.catalog_id for image in images], heldout, options.epoch or EPOCH,
        [image.sigma for image in images], [image.stamp_ns for image in images])
    told = {
        'images': [{'image': image.name, 'split': 'heldout' if held else 'fit',
                    'spots': image.spots, 'stars': len(image.catalog_id),
                    'utc': _utc(image.stamp_ns)} for image, held in zip(images, heldout)],
        'left_out': left_out, 'flipped': found.flipped, 'width': found.width,
        'height': found.height, 'notices': notices}
    return _Source(stars, found.width, found.height, found.focal_length_px, told)


def _utc(stamp: int | None) -> str | None:
    return None if stamp is None else datetime.fromtimestamp(
        stamp // 1000 / 1e6, timezone.utc).replace(tzinfo=None).isoformat()


def _site(options: argparse.Namespace) -> Site | None:
    if not options.site:
        return None
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
