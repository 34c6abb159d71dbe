# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Still images of the sky from their files: read, measured, identified, ready to calibrate.

An image is identified lost in space, with a camera of which the field is known at best. What can
not be used is left out and named. Stars that are saturated, blended, cut by the edge or of another
shape than the rest help to identify an image but not to calibrate: their places are biased.

A folder may hold images of several sizes or focal lengths: each is a camera of its own. Where all
images of one show the sky in the mirror only, rows counted from the wrong end are the likely
reason: they are flipped, top to bottom, and so is the camera that is calibrated then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
import csv
from dataclasses import dataclass
from datetime import tzinfo
from os import PathLike
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.image import CentroidConfig
from starcal_ros.files.output import whole
from starcal_ros.sky.apparent import Observer
from starcal_ros.workflows.still_images.measured import Measured, measure
from starcal_ros.workflows.still_images.repeated import COPY, originals
from starcal_ros.workflows.still_images.said import by_text, listed
from starcal_ros.workflows.still_images.search import StarImage, StarSearch

_ZOOM = 1.03            # focal lengths that differ by more are those of two cameras


class NoStarsError(ValueError):
    """No image can be used.

    Attributes
    ----------
    measured : tuple of Measured
        Images that could be read.
    left_out : dict
        The reason, by name.
    """

    def __init__(self, text: str, measured: Iterable[Measured], left_out: dict[str, str]) -> None:
        super().__init__(text)
        self.measured, self.left_out = tuple(measured), left_out


@dataclass(frozen=True)
class StarImages:
    """The images of one camera in a folder.

    Attributes
    ----------
    width, height : int
        Of all of them [px].
    images : tuple of StarImage
        Those that are identified, all flipped or none, in the order of their names.
    """

    width: int
    height: int
    images: tuple[StarImage, ...]

    @property
    def flipped(self) -> bool:
        """Whether the images were flipped, top to bottom."""
        return any(image.mirrored for image in self.images)

    @property
    def focal_length_px(self) -> float:
        """Median focal length [px]."""
        return float(np.median([image.focal_length_px for image in self.images]))


class StarFolder(NamedTuple):
    """What a folder of images gave.

    Attributes
    ----------
    cameras : tuple of StarImages
        Images of one size and focal length each; those of most images first.
    left_out : dict
        Images that can not be used, by name, with the reason.
    notices : tuple of str
        What a user should know of the files.
    measured : tuple of Measured
        All images that could be read, with their spots.
    """

    cameras: tuple[StarImages, ...]
    left_out: dict[str, str]
    notices: tuple[str, ...]
    measured: tuple[Measured, ...] = ()


def read(folder: str | PathLike[str], fov_deg: float | None, epoch_utc: str | None,
         config: CentroidConfig = CentroidConfig(), observer: Observer = Observer('barycentre'),
         mask: NDArray[np.bool_] | None = None, zone: tzinfo | None = None,
         on_progress: Callable[[float], None] = lambda part: None) -> StarFolder:
    """Find the stars in the images of a folder.

    Parameters
    ----------
    folder : path
        With images as `imaging.files` reads them.
    fov_deg : float or None
        Field of view across the width, as `search` has it; None where it is not known.
    epoch_utc : str or None
        Time of the images, whatever the files say, ISO 8601.
    config : CentroidConfig
        How stars are measured; a saturation that it leaves open is that of the file's type.
    observer : Observer
        Who looks, and from where, for images whose time is known.
    mask : (height, width) bool array, optional
        Pixels that are looked at.
    zone : tzinfo, optional
        Of the clock of the camera, whatever the files say.
    on_progress : callable
        Called with the part done, 0 to 1.

    Raises
    ------
    ImageFileError, ConfigError
        Where there is no image, or the field is impossible.
    NoStarsError
        Where no image can be used.
    ImportError
        Where tetra3rs is missing.
    """
    search = StarSearch(fov_deg, epoch_utc, observer, zone)
    measured = measure(folder, config, mask, lambda part: on_progress(0.5 * part))
    left_out = dict(measured.left_out)
    if not measured.images:
        raise NoStarsError(f'{folder}: none of its images can be read: {_reasons(left_out)}',
                           (), left_out)
    found: dict[tuple[int, int], list[StarImage]] = {}
    shapes = {image.name: image.shape for image in measured.images}
    for stars in search.images(measured.images, lambda part: on_progress(0.5 + 0.5 * part)):
        if observer.site is not None and stars.stamp_ns is None:
            left_out[stars.name] = ('the site needs a time, which neither the file nor the epoch '
                                    'tells')
        else:
            found.setdefault(shapes[stars.name], []).append(stars)
    left_out |= search.left_out
    cameras = [StarImages(width, height, _once(_one_way(images, left_out), left_out))
               for (height, width), those in found.items() for images in _by_focal_length(those)]
    if not cameras:
        count = len(measured.images) + len(measured.left_out)
        raise NoStarsError(f'{folder}: none of {count} images can be used ({search.looked_for}): '
                           f'{_reasons(left_out)}', measured.images, left_out)
    return StarFolder(tuple(sorted(cameras, key=lambda camera: -len(camera.images))),
                      dict(sorted(left_out.items())),
                      (*measured.notices, *_overridden(measured.images, epoch_utc, zone)),
                      tuple(measured.images))


def _overridden(images: Sequence[Measured], epoch_utc: str | None, zone: tzinfo | None
                ) -> Iterator[str]:
    """Say where what the user states takes the place of what the files say."""
    if epoch_utc is not None:
        if told := [image.name for image in images if image.taken]:
            yield f'--epoch takes the place of the times of {listed(told)}'
    elif zone is not None:
        if told := [image.name for image in images if image.taken and image.taken.tzinfo]:
            yield f'--utc-offset takes the place of the zone that {listed(told)} state'


def _by_focal_length(images: list[StarImage]) -> list[list[StarImage]]:
    """Return the images of each focal length of a zoom, or of each camera."""
    groups: list[list[StarImage]] = []
    for image in sorted(images, key=lambda image: image.focal_length_px):
        if not groups or image.focal_length_px > _ZOOM * groups[-1][-1].focal_length_px:
            groups.append([])
        groups[-1].append(image)
    return [sorted(group, key=lambda image: image.name) for group in groups]


def _one_way(images: list[StarImage], left_out: dict[str, str]) -> tuple[StarImage, ...]:
    """Return the images that are flipped as most are, and name the others."""
    flipped = 2 * sum(image.mirrored for image in images) > len(images)
    for image in images:
        if image.mirrored != flipped:
            how = 'in the mirror only' if image.mirrored else 'without a mirror'
            left_out[image.name] = (f'its stars match {how}, unlike those of most images: flip '
                                    'it, top to bottom')
    return tuple(image for image in images if image.mirrored == flipped)


def _once(images: tuple[StarImage, ...], left_out: dict[str, str]) -> tuple[StarImage, ...]:
    """Return one image of each exposure, and name its copies."""
    rows = originals([image.uv_raster for image in images], [image.sigma for image in images],
                     [image.catalog_id for image in images])
    for image, row in zip(images, rows):
        if images[row] is not image:
            left_out[image.name] = COPY.format(images[row].name)
    return tuple(image for image, row in zip(images, rows) if images[row] is image)


def write_table(path: str | PathLike[str], images: Sequence[StarImage], heldout: Sequence[bool]
                ) -> None:
    """Write the stars of images as `table.read_centroids` reads them."""
    with whole(path) as draft, draft.open('w', newline='', encoding='utf-8') as stream:
        table = csv.writer(stream)
        table.writerow(['image', 'u', 'v', 'catalog_id', 'sigma', 'split'])
        for image, held in zip(images, heldout):
            for (u, v), star, sigma in zip(image.uv_raster.tolist(), image.catalog_id.tolist(),
                                           image.sigma.tolist()):
                table.writerow([image.name, f'{u:.5f}', f'{v:.5f}', star, f'{sigma:.5f}',
                                'heldout' if held else 'fit'])


def _reasons(left_out: dict[str, str]) -> str:
    return listed([f'{names}: {why}' for names, why in by_text(sorted(left_out.items()))], '; ')
