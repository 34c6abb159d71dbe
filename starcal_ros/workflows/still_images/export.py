# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A camera of still images, and where each image looked, in the files of other programs."""

from __future__ import annotations

from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from starcal_ros.config.models import detector, observer
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.files.output import whole, write_text
from starcal_ros.results import camera_files
from starcal_ros.results.camera_files import colmap, wcs
from starcal_ros.results.camera_files.colmap import AimedImage
from starcal_ros.results.camera_files.foreign_camera import ForeignCamera
from starcal_ros.sky.apparent import apparent_places
from starcal_ros.sky.catalog import Catalog
from starcal_ros.workflows.still_images.calibration import StillImageCamera
from starcal_ros.workflows.still_images.opencv_camera import from_estimate
from starcal_ros.workflows.still_images.pipeline import Source

IMAGES = 'images.txt'
WCS_FOLDER = 'wcs'
_COARSE_PX = 0.01       # by which a world coordinate system misses its camera, that is said


def write(folder: str | PathLike[str], source: Source, found: StillImageCamera) -> list[str]:
    """Write the files into a folder that exists; return what a user should know of them."""
    texts, notices = camera_files.files(_camera(found))
    if found.own_f_px is not None:
        notices.append(f'all files but those in {WCS_FOLDER} have the mean focal length of the '
                       'images in place of that of each')
    aimed = [*_aimed(found)]
    texts[IMAGES] = colmap.images(aimed)
    for name, text in texts.items():
        write_text(Path(folder) / name, text)
    places = Path(folder) / WCS_FOLDER
    places.mkdir(exist_ok=True)
    worst, order = 0.0, 0
    for image in aimed:
        made = _wcs(source, found, image)
        if made.worst_px > worst:
            worst, order = made.worst_px, made.order
        with whole(places / f'{image.name.replace("/", "_")}.wcs') as draft:
            draft.write_bytes(made.content)
    if worst > _COARSE_PX:
        notices.append(f'{WCS_FOLDER}: SIP of order {order} misses this lens by {worst:.2g} px '
                       'in the worst place')
    return notices


def _camera(found: StillImageCamera) -> ForeignCamera:
    lens, values = found.optics
    count = len(values)
    (f, cu, cv, *coefficients), _ = from_estimate(CameraEstimate(
        values, found.estimate.covariance[:count, :count], 0, 0), found.scenario, lens)
    pixels = detector(found.scenario.camera)
    return ForeignCamera(lens.name, pixels.width, pixels.height, float(f),
                         (float(cu), float(cv)), tuple(map(float, coefficients)))


def _aimed(found: StillImageCamera) -> Iterator[AimedImage]:
    """Yield the images whose attitudes are fitted, those held out as well, with their stars."""
    middle = detector(found.scenario.camera).centre_raster
    for refit in filter(None, (found.fit, found.heldout)):
        for k, (name, C_si) in enumerate(zip(refit.names, refit.adjusted.C_si)):
            mine = refit.adjusted.used & (refit.spots.frame == k)
            yield AimedImage(name, C_si, refit.adjusted.intrinsics_of(np.array([k]))[0],
                             refit.spots.uv[mine] + middle)


def _wcs(source: Source, found: StillImageCamera, image: AimedImage) -> wcs.Wcs:
    images = source.images
    stamp_ns = int(images.frames.stamp_ns[images.names.index(image.name)])

    def seen(u_i: Array) -> Array:
        """Return where the observer sees ICRS directions: aberration and air."""
        nought = np.zeros(len(u_i))
        stars = Catalog(np.arange(len(u_i)), np.arctan2(u_i[:, 1], u_i[:, 0]),
                        np.arcsin(np.clip(u_i[:, 2], -1.0, 1.0)), *(nought,) * 5)
        return apparent_places(stars, stars.hip, [stamp_ns], [len(u_i)],
                               observer(found.scenario.observer))

    lens, values = found.optics
    return wcs.of_image(lens, image.values[:len(values)], image.C_si,
                        detector(found.scenario.camera), seen,
                        bool(source.details.get('flipped', False)), _cards(source, image.name))


def _cards(source: Source, name: str) -> tuple[tuple[str, str, str], ...]:
    known: dict[str, Any] = next((each for each in source.details.get('images', ())
                                  if each['image'] == name), {})
    utc = known.get('utc')
    return (('DATE-AVG', utc, 'middle of the exposure, UTC'),) if utc else ()
