# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A folder of images of the sky, or a table of their stars, in; the camera out.

::

    from starcal_ros.workflows.still_images import pipeline
    camera = pipeline.calibrate(pipeline.of_folder('images', heldout_every=4)).camera
    camera.as_dict()['f_px']
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timezone, tzinfo
from os import PathLike, fspath
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.config.image import CentroidConfig
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import lenses
from starcal_ros.results.document import CalibrationError
from starcal_ros.sky.apparent import Observer
from starcal_ros.sky.refraction import LOWEST_DEG, Site
from starcal_ros.workflows.still_images import (atmosphere, calibration, clock,
                                                folder as star_folder, opencv_camera, table)
from starcal_ros.workflows.still_images.calibration import StillImageCamera
from starcal_ros.workflows.still_images.folder import StarImages
from starcal_ros.workflows.still_images.measured import Measured, read_mask
from starcal_ros.workflows.still_images.repeated import COPY, originals
from starcal_ros.workflows.still_images.table import StillImages

EPOCH = '2020-01-01T00:00:00'
"""Time of images of which none is known: a few years move no star by a hundredth of a pixel."""

_UNFIT = {'interstar': '; on still images interstar needs intrinsics.interstar_equations TCOC or '
                       'TCWC',
          'predicted_centroid': '; predicted_centroid needs a gyro'}
_NAMED = 3              # images that a notice names, at most


@dataclass(frozen=True)
class Conditions:
    """What is known of how images were taken.

    Attributes
    ----------
    fov_deg : float, optional
        Field of view across the width; found from the stars where it is not known.
    epoch_utc : str, optional
        When, ISO 8601, whatever the files say.
    site : Site, optional
        Where: their centroids are freed of refraction.
    aberration : bool
        Whether the observer moves with the Earth; with a site always.
    zone : tzinfo, optional
        Of the clock of the camera, whatever the files say; where neither tells it is UTC.
    """

    fov_deg: float | None = None
    epoch_utc: str | None = None
    site: Site | None = None
    aberration: bool = False
    zone: tzinfo | None = None

    @property
    def velocity(self) -> str:
        """Whose velocity aberrates the stars."""
        return 'geocentre' if self.aberration or self.site else 'barycentre'


@dataclass(frozen=True)
class Source:
    """Stars of still images, ready to calibrate with.

    Attributes
    ----------
    name : str
        The folder or the table.
    images : StillImages
    width, height : int
        Of all of them [px].
    focal_length_px : float
        To begin with.
    conditions : Conditions
    left_out : dict
        Images that can not be used, by name, with the reason.
    notices : tuple of str
        What else a user should know.
    details : dict
        What a result says of the images.
    others : tuple of Source
        The other cameras of the same folder.
    measured : tuple of Measured
        All images of the folder that could be read, with their spots.
    """

    name: str
    images: StillImages
    width: int
    height: int
    focal_length_px: float
    conditions: Conditions
    left_out: Mapping[str, str]
    notices: tuple[str, ...]
    details: Mapping[str, Any]
    others: tuple[Source, ...] = ()
    measured: tuple[Measured, ...] = ()

    @property
    def label(self) -> str:
        """The camera in a few words."""
        return (f'{self.width} x {self.height} px, f about {self.focal_length_px:.4g} px, '
                f'{len(self.images.names)} images')

    def scenario(self, method: str) -> Scenario:
        """Return what is known of the camera, for a method."""
        return calibration.scenario_of(self.width, self.height, self.focal_length_px, method,
                                       self.conditions.velocity, self.conditions.site)


class Calibrated(NamedTuple):
    """What a calibration gave.

    Attributes
    ----------
    camera : StillImageCamera
    outcome : dict
        The result as it is written.
    """

    camera: StillImageCamera
    outcome: dict[str, Any]


def of_folder(folder: str | PathLike[str], conditions: Conditions = Conditions(),
              heldout_every: int | None = None, saturation_counts: float | None = None,
              stars_csv: str | PathLike[str] | None = None,
              mask: str | PathLike[str] | None = None,
              on_progress: Callable[[float], None] = lambda part: None) -> Source:
    """Measure and identify the stars in the images of a folder.

    Parameters
    ----------
    folder : path
        With images as `imaging.files` reads them.
    conditions : Conditions
    heldout_every : int, optional
        Hold out every so many-th image: it judges the camera and takes no part.
    saturation_counts : float, optional
        Counts from which a pixel is saturated, where the files do not tell.
    stars_csv : path, optional
        Table to write of the stars, for `of_table`.
    mask : path, optional
        Image that is black where the others are not to be looked at.
    on_progress : callable
        Called with the part done, 0 to 1.

    Raises
    ------
    ImageFileError, ConfigError, NoStarsError, ImportError
        As `folder.read`; ConfigError also where site or times can not be right.
    """
    found = star_folder.read(folder, conditions.fov_deg, conditions.epoch_utc,
                             CentroidConfig(saturation_counts=saturation_counts),
                             Observer(conditions.velocity, site=conditions.site),
                             None if mask is None else read_mask(mask), conditions.zone,
                             on_progress)
    first, *others = [_of_camera(fspath(folder), camera, conditions, heldout_every)
                      for camera in found.cameras]
    if stars_csv is not None:
        star_folder.write_table(stars_csv, found.cameras[0].images,
                                _held(len(found.cameras[0].images), heldout_every))
    notices = [*found.notices]
    if others:
        notices.append(f'{len(others) + 1} cameras, by size and focal length of the images: '
                       + '; '.join(source.label for source in (first, *others)))
    return replace(first, left_out=found.left_out, notices=(*notices, *first.notices),
                   details={**first.details, 'left_out': found.left_out}, others=tuple(others),
                   measured=found.measured)


def _of_camera(folder: str, camera: StarImages, conditions: Conditions,
               heldout_every: int | None) -> Source:
    """Return the images of one camera as a source, ready to calibrate."""
    images = camera.images
    notices = []
    if camera.flipped:
        notices.append('the images show the sky in the mirror: they were flipped, top to bottom, '
                       'and v0, p1 are those of the flipped images')
    unsure = [image.name for image in images if not image.has_zone]
    if conditions.site is not None and unsure:
        notices.append(f'{", ".join(unsure[:_NAMED])}{" ..." * (len(unsure) > _NAMED)}: a time '
                       'without a zone or without a time of the day is taken as UTC; '
                       '--utc-offset states the zone')
    heldout = _held(len(images), heldout_every)
    stars = table.assemble(
        [image.name for image in images], [image.uv_raster for image in images],
        [image.catalog_id for image in images], heldout, conditions.epoch_utc or EPOCH,
        [image.sigma for image in images], [image.stamp_ns for image in images])
    details = {
        'images': [{'image': image.name, 'split': 'heldout' if held else 'fit',
                    'spots': image.spots, 'stars': len(image.catalog_id),
                    'utc': _utc(image.stamp_ns)} for image, held in zip(images, heldout)],
        'left_out': {}, 'flipped': camera.flipped, 'width': camera.width,
        'height': camera.height}
    return _above_horizon(Source(
        folder, stars, camera.width, camera.height, camera.focal_length_px, conditions, {},
        tuple(notices), details))


def _held(count: int, every: int | None) -> list[bool]:
    """Tell which images are held out: every so many-th."""
    every = every or count + 1
    return [k % every == every - 1 for k in range(count)]


def of_table(stars_csv: str | PathLike[str], width: int, height: int,
             conditions: Conditions = Conditions()) -> Source:
    """Read a table of identified stars.

    Parameters
    ----------
    stars_csv : path
        As `table.read_centroids` reads it.
    width, height : int
        Of the images [px].
    conditions : Conditions
        A site needs the epoch.

    Raises
    ------
    ConfigError
        Where a row is not what it should be, stars are too few to begin with, or site and epoch
        can not be right.
    """
    if conditions.site is not None and conditions.epoch_utc is None:
        raise ConfigError('site: needs the epoch, the time of the images')
    images, left_out = _once(
        table.read_centroids(fspath(stars_csv), conditions.epoch_utc or EPOCH))
    f_px = (calibration.focal_length_px(images, width, height) if conditions.fov_deg is None
            else opencv_camera.focal_length_of_field(conditions.fov_deg, width))
    return _above_horizon(Source(fspath(stars_csv), images, width, height, f_px, conditions,
                                 left_out, (), {'left_out': left_out}))


def _once(images: StillImages) -> tuple[StillImages, dict[str, str]]:
    """Return one image of each exposure, and why its copies are left out."""
    frames, edges = images.frames, images.frames.first[1:-1]
    rows = originals(np.split(frames.uv_raster, edges), np.split(frames.sigma, edges),
                     np.split(frames.catalog_id, edges))
    kept = rows == np.arange(len(rows))
    return images.which(kept), {images.names[k]: COPY.format(images.names[rows[k]])
                                for k in np.flatnonzero(~kept)}


def calibrate(source: Source, method: str = 'bundle',
              parameters: Mapping[str, Any] | None = None, lens: str = lenses.PLUMB_BOB,
              phase: bool = False) -> Calibrated:
    """Calibrate the camera of still images.

    Parameters
    ----------
    source : Source
        Of `of_folder` or `of_table`.
    method : str
        Calibration method.
    parameters : mapping, optional
        Other parameters of the scenario, by name, such as ``intrinsics.estimate``.
    lens : str
        Lens model, one of `lens.CHOICES`; others than T18's need the bundle adjustment.
    phase : bool
        Estimate the pixel phase, too, which needs that as well.

    Raises
    ------
    ConfigError
        Where a parameter is not what it should be.
    CalibrationError
        Where the method has nothing to say.
    """
    scenario = source.scenario(method).replace(dict(parameters or {}))
    method, site = scenario.intrinsics.method, source.conditions.site
    if method != 'bundle' and lens != lenses.PLUMB_BOB:
        raise ConfigError(f'--lens: {lens} needs the method bundle, got {method}')
    if method != 'bundle' and phase:
        raise ConfigError(f'--pixel-phase: needs the method bundle, got {method}')
    found = calibration.calibrate(source.images, scenario, lens, phase)
    if found is None:
        raise CalibrationError(
            f'{source.name}: no camera from {len(source.images.names)} images with '
            f'{len(source.images.frames.catalog_id)} stars' + _UNFIT.get(method, ''))
    air = None if site is None else clock.look(
        source.images, scenario, _hours(source.conditions.zone), found)
    if air is not None:
        found = found.with_test(air.test, air.factors)
    outcome = {'method': method, 'source': source.name, **found.as_dict(), **source.details}
    if site is not None:
        outcome['air'] = {'site': [site.latitude_deg, site.longitude_deg, site.height_m],
                          **dict(zip(('pressure_hpa', 'temperature_c'), site.air)),
                          'doubt': air.doubt if air else ''}
    return Calibrated(found, outcome)


def _above_horizon(source: Source) -> Source:
    """Take the numbers from stars that are too low to know their refraction."""
    images, site = source.images, source.conditions.site
    if site is None:
        return source
    frames, sunk, low = atmosphere.without_low_stars(
        images.frames, replace(source, conditions=replace(
            source.conditions, site=None)).scenario('bundle'), site)
    if sunk.any():
        raise ConfigError(f'site: {sunk.sum()} of {len(sunk)} images, such as '
                          f'{images.names[int(sunk.argmax())]}, show stars below the horizon: '
                          'site or times are wrong')
    notices = [f'{low} stars lower than {LOWEST_DEG:g} deg are left out'] if low else []
    return replace(source, images=replace(images, frames=frames),
                   notices=(*notices, *source.notices))


def _hours(zone: tzinfo | None) -> float:
    offset = None if zone is None else zone.utcoffset(None)
    return 0.0 if offset is None else offset.total_seconds() / 3600.0


def _utc(stamp: int | None) -> str | None:
    return None if stamp is None else datetime.fromtimestamp(
        stamp // 1000 / 1e6, timezone.utc).replace(tzinfo=None).isoformat()
