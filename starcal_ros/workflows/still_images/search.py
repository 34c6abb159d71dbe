# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which stars the images of a folder show, with as much as is known of their field.

A field is stated, or told by the file, or that of other images of the same size. Where it is none
of these, ever rarer ones are tried, for as long as no image of the size is identified: the
patterns of narrow fields take a quarter of a minute to prepare. Fisheyes come last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone, tzinfo
from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.camera import Detector
from starcal_ros.core.utc import unix_ns
from starcal_ros.identification.camera_guess import CameraGuess
from starcal_ros.identification.fisheye_guess import FisheyeGuess
from starcal_ros.identification.identifier import (MIN_STARS, Identification, Identifier,
                                                   MirroredError)
from starcal_ros.imaging.centroids import BEYOND_FIT_PX
from starcal_ros.imaging.spread import rank_in_cell
from starcal_ros.sky import depth
from starcal_ros.sky.apparent import Observer
from starcal_ros.workflows.still_images import why_not
from starcal_ros.workflows.still_images.measured import Measured
from starcal_ros.workflows.still_images.opencv_camera import WIDEST_PINHOLE_DEG, check_field
from starcal_ros.workflows.still_images.standing import standing

FIELD_DEG = (8.0, 40.0)
"""Fields of view across the width in which a camera of unknown field is looked for first."""
RARE_DEG = ((40.0, 55.0), (55.0, 70.0), (70.0, 85.0), (85.0, 94.0), (94.0, 105.0), (3.5, 8.0),
            (1.5, 3.5), (0.95, 1.5))
"""Those in which it is looked for then, while no image of its size is identified. The wider a
field, the more the angles of a pattern depend on it: of 40 to 100 deg at once, 90 is not found."""
RARE_IMAGES = 8
"""Images of a size of which rare fields are tried, those of most spots."""
FIELD_ERROR = 0.1
"""Part of itself by which a stated field of view may be wrong."""

_TOLD_ERROR, _KNOWN_ERROR = 0.15, 0.03      # of a field that a file tells, that others have
_WIDEST_TOLD_DEG = 130.0
_FISHEYE_DEG = 60.0     # across the width, from which on it may be one
_FISHEYE_ERROR = 0.08   # of a focal length, at which a fisheye is still identified
_FISHEYE_STEP = 1.12    # from one that is tried to the next
_FISHEYE_IMAGES = 4     # of which all are tried
_CORNER_DEG = 50.0      # from the axis, in the narrowest that is tried
_MORE = 1.1             # times the stars, that a fisheye must have in place of a pinhole
_CIRCLE = 0.8           # of the short side, that a hemisphere fills in the widest
_BEST_OF_CELL = 2       # spots of each cell that a second search begins with

Field = tuple[float, float]


class Fisheye(NamedTuple):
    """A lens of about some focal length, whose images grow with the angle from its axis.

    Attributes
    ----------
    focal_px : float
    """

    focal_px: float


Optics = Field | Fisheye


@dataclass(frozen=True)
class StarImage:
    """One image and its stars.

    Attributes
    ----------
    name : str
        File.
    uv_raster : (n, 2) array
        Clean centroids of identified stars [px].
    sigma : (n,) array
        Of them, each axis; right but for a factor [px].
    catalog_id : (n,) int64 array
        Hipparcos numbers.
    spots : int
        All spots that were found.
    stamp_ns : int or None
        When it was taken, UTC since the Unix epoch; None where the file does not say.
    has_zone : bool
        Whether the file, or the user, says that the time is UTC, or by how much it is not.
    focal_length_px : float
        That fits it.
    mirrored : bool
        Flipped to be identified.
    """

    name: str
    uv_raster: Array
    sigma: Array
    catalog_id: Ints
    spots: int
    stamp_ns: int | None
    has_zone: bool
    focal_length_px: float
    mirrored: bool


class StarSearch:
    """Finds the stars of images.

    Parameters
    ----------
    fov_deg : float or None
        Field of view across the width, to FIELD_ERROR; beyond 120 deg that of a fisheye.
    epoch_utc : str or None
        Time of the images, whatever the files say, ISO 8601.
    observer : Observer
        Who looks, and from where, for images whose time is known.
    zone : tzinfo, optional
        Of the clock of the camera, whatever the files say.

    Raises
    ------
    ConfigError
        Where the field is impossible.
    """

    def __init__(self, fov_deg: float | None, epoch_utc: str | None, observer: Observer,
                 zone: tzinfo | None = None) -> None:
        if fov_deg is not None:
            check_field(fov_deg)
        self._fov_deg = fov_deg
        self._stated = (None if fov_deg is None or fov_deg > WIDEST_PINHOLE_DEG
                        else _about(fov_deg, FIELD_ERROR))
        self._epoch_utc, self._observer = epoch_utc, observer
        self._identifiers: dict[tuple[tuple[int, int], Optics], Identifier] = {}
        self._known: dict[tuple[int, int], list[float]] = {}
        self._zone = zone
        self._tried: dict[str, Field] = {}
        self._standing: dict[str, Mask] = {}
        self.left_out: dict[str, str] = {}

    @property
    def looked_for(self) -> str:
        """Which fields were."""
        if self._stated is not None:
            return f'field of {self._stated[0]:g} to {self._stated[1]:g} deg looked for'
        if self._fov_deg is not None:
            return f'fisheye of about {self._fov_deg:g} deg looked for'
        low, high = (min(low for low, _ in (FIELD_DEG, *RARE_DEG)),
                     max(high for _, high in (FIELD_DEG, *RARE_DEG)))
        return f'field of {low:g} to {high:g} deg, and fisheyes, looked for'

    def images(self, measured: Sequence[Measured], on_progress: Callable[[float], None]
               ) -> list[StarImage]:
        """Return those that are identified; why others are not is in `left_out`.

        Raises
        ------
        ImportError
            Where tetra3rs is missing.
        """
        found: dict[str, StarImage] = {}
        self._standing = standing(measured)
        for k, image in enumerate(measured):
            self._try(image, self._first(image), found)
            on_progress((k + 1) / len(measured))
        for shape in {image.shape for image in measured}:
            missing = [image for image in measured
                       if image.shape == shape and image.name not in found]
            promising = sorted(missing, key=lambda image: -len(image.centroids.flux))
            for field in RARE_DEG if self._fov_deg is None else ():
                for image in promising[:RARE_IMAGES] if shape not in self._known else ():
                    self._try(image, [field], found)
            for fisheye in self._fisheyes(shape):
                for image in promising[:_FISHEYE_IMAGES] if shape not in self._known else ():
                    self._try(image, [fisheye], found)
            for image in missing:
                if image.name not in found:
                    self._try(image, self._others(image), found)
        return [found[image.name] for image in measured if image.name in found]

    def _fisheyes(self, shape: tuple[int, int]) -> list[Fisheye]:
        """Return those of which images of a size may be."""
        height, width = shape
        if self._fov_deg is None:
            longest = 0.5 * np.hypot(width, height) / np.radians(_CORNER_DEG)
            shortest = _CIRCLE * min(shape) / np.pi
        elif self._fov_deg < _FISHEYE_DEG:
            return []
        else:
            about = width / np.radians(self._fov_deg)
            longest, shortest = about * (1.0 + FIELD_ERROR), about / (1.0 + FIELD_ERROR)
        steps = int(np.ceil(np.log(longest / shortest) / np.log(_FISHEYE_STEP)))
        return [Fisheye(f) for f in np.geomspace(longest, shortest, steps + 1).tolist()]

    def _first(self, image: Measured) -> Iterator[Optics]:
        """Yield the fields in which an image is looked for before all others."""
        if self._stated is not None:
            yield self._stated
        if self._fov_deg is not None:
            return
        yield from self._others(image)
        if image.focal_px is not None:
            yield from _of_focal_length(image.focal_px, image, _TOLD_ERROR)
        yield FIELD_DEG

    def _others(self, image: Measured) -> Iterator[Optics]:
        """Yield the fields of other images of the same size, upright or lying."""
        for focal_px in (*self._known.get(image.shape, ()),
                         *self._known.get(image.shape[::-1], ())):
            yield from _of_focal_length(focal_px, image, _KNOWN_ERROR)

    def _try(self, image: Measured, fields: Iterable[Optics], found: dict[str, StarImage]) -> None:
        """Look for an image in some fields, and write down its stars or why there are none."""
        said = why_not.before(image)
        for field in fields if said is None else ():
            if not isinstance(field, Fisheye):
                low, high = self._tried.get(image.name, field)
                self._tried[image.name] = min(low, field[0]), max(high, field[1])
            stars = self._identify(image, field)
            if isinstance(stars, StarImage):
                found[image.name] = stars = self._whole(image, field, stars)
                self.left_out.pop(image.name, None)
                known = self._known.setdefault(image.shape, [])
                if not any(abs(stars.focal_length_px / f - 1.0) < _KNOWN_ERROR for f in known):
                    known.append(stars.focal_length_px)
                return
            said = stars
        if said is not None:
            self.left_out[image.name] = said

    def _whole(self, image: Measured, field: Optics, stars: StarImage) -> StarImage:
        """Return those of a fisheye where only its middle was identified, as a pinhole."""
        if isinstance(field, Fisheye) or field[1] < _FISHEYE_DEG:
            return stars
        more = self._identify(image, Fisheye(stars.focal_length_px))
        return more if isinstance(more, StarImage) and (
            len(more.catalog_id) > _MORE * len(stars.catalog_id)) else stars

    def _identify(self, image: Measured, field: Optics) -> StarImage | str:
        """Return an image's stars, or why there are none."""
        key = image.shape, field
        height, width = image.shape
        if key not in self._identifiers:
            self._identifiers[key] = _identifier(Detector(width, height, 1.0), field,
                                                 self._observer)
        stamp_ns = self._stamp_ns(image.taken)
        stands = self._standing.get(image.name, np.zeros(len(image.centroids.flux), bool))
        mirrored, uv = False, image.centroids.uv_raster
        try:
            found = _search(self._identifiers[key], image, uv, stamp_ns, stands)
        except MirroredError:
            uv, mirrored = uv * [1.0, -1.0] + [0.0, height - 1.0], True
            try:
                found = _search(self._identifiers[key], image, uv, stamp_ns, stands)
            except MirroredError:
                found = None
        if found is None:
            return why_not.after(image, self._tried.get(image.name), self._fov_deg is not None,
                                 stands)
        centroids = image.centroids
        use = (found.catalog_id != 0) & (centroids.flags == 0)
        if use.sum() < MIN_STARS:
            return f'{use.sum()} clean stars (not saturated, blended or cut), needs {MIN_STARS}'
        return StarImage(
            image.name, uv[use], np.hypot(centroids.sigma[use], BEYOND_FIT_PX),
            found.catalog_id[use], len(uv), stamp_ns,
            bool(self._zone or self._epoch_utc) or image.taken is None
            or image.taken.tzinfo is not None,
            float(found.view.intrinsics[2]), mirrored)

    def _stamp_ns(self, taken: datetime | None) -> int | None:
        """Return when an image was taken: what the user states, or else its file."""
        if self._epoch_utc is not None:
            return unix_ns(self._epoch_utc)
        if taken is None:
            return None
        zone = self._zone or taken.tzinfo or timezone.utc
        return unix_ns(taken.replace(tzinfo=zone).astimezone(timezone.utc).isoformat())


def _of_focal_length(focal_px: float, image: Measured, error: float) -> Iterator[Optics]:
    """Yield a pinhole of about a focal length, and a fisheye where its field is wide.

    What distorts a wide field as a fisheye does is identified as the one, or as the other.
    """
    field_deg = _field_deg(focal_px, image)
    if field_deg < _WIDEST_TOLD_DEG:
        yield _about(field_deg, error)
    if image.shape[1] / focal_px > np.radians(_FISHEYE_DEG):
        yield Fisheye(focal_px)


def _identifier(detector: Detector, field: Optics, observer: Observer) -> Identifier:
    if isinstance(field, Fisheye):
        return Identifier(FisheyeGuess.of_focal_length(detector, field.focal_px, _FISHEYE_ERROR),
                          observer)
    area = field[0] * field[1] * detector.height / detector.width
    return Identifier(CameraGuess.of_field(detector, *field), observer, depth.limit_for(area))


def _search(identifier: Identifier, image: Measured, uv: Array, stamp_ns: int | None,
            stands: Mask) -> Identification | None:
    """Identify an image by its brightest spots, or else by some of the others.

    The brightest are those of a tree or a town, where there is one.
    """
    spots = image.centroids
    found = identifier.lost_in_space(uv, spots.flux, stamp_ns, spots.sigma)
    if found is not None:
        return found
    for rows in _others_to_begin_with(image, stands):
        found = identifier.lost_in_space(uv[rows], spots.flux[rows], stamp_ns, spots.sigma[rows])
        if found is not None:
            return identifier.track(found.view, uv, spots.flux, stamp_ns, spots.sigma) or (
                found.among(rows, len(uv)))
    return None


def _others_to_begin_with(image: Measured, stands: Mask) -> Iterator[Ints]:
    """Yield rows of spots: the best of each cell, of good shape; those that do not stand still."""
    spots = image.centroids
    good = np.flatnonzero(spots.flags == 0)
    rank, _ = rank_in_cell(spots.uv_raster[good], spots.flux[good], image.shape)
    yield good[rank < _BEST_OF_CELL]
    if stands.any():
        yield np.flatnonzero(~stands)


def _about(field_deg: float, error: float) -> Field:
    low, high = field_deg * (1.0 - error), field_deg * (1.0 + error)
    return low, max(min(high, _WIDEST_TOLD_DEG), low)


def _field_deg(focal_px: float, image: Measured) -> float:
    return 2.0 * float(np.degrees(np.arctan(image.shape[1] / (2.0 * focal_px))))
