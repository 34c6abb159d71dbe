# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Centroids of the stars of an image, each with its covariance and what may be wrong with it.

Light and noise (`light`), spots over the threshold (`detection`), the shape that the
bright ones have in common, and with that shape the place of each (`psf_fit`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from starcal_ros.config.image import CentroidConfig
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.imaging.cutouts import Cutouts, Shape, trail_of
from starcal_ros.imaging.detection import Detections, find_spots
from starcal_ros.imaging.lattice import Lattice
from starcal_ros.imaging.light import Light
from starcal_ros.imaging.picture import Picture
from starcal_ros.imaging.pixels import Scale
from starcal_ros.imaging.psf_fit import fit
from starcal_ros.imaging.spread import best, clear_of_crowds

Rows = Ints

SATURATED, BLENDED, EDGE, ELONGATED = 1, 2, 4, 8
"""Flags of a centroid: pixels at the top of the range; another spot within reach; part of it
outside the image or not known; a shape that is not the frame's, such as a double star or a
satellite."""

BEYOND_FIT_PX = 0.01
"""What no fit of a spot knows of, each axis: uneven pixels, proper motion to the epoch [px]."""

_CANDIDATES, _SHAPE_SPOTS, _SHAPE_ROUNDS = 100, 20, 10
_SETTLED = 5e-3                 # of the second moments, a change that does not matter
_LEAST_SHOT = 1e-6              # of the noise: a million electrons of it show no shot noise
_LEAST_SHAPE_SPOTS = 3
_NEIGHBOUR_REACH_PX = 2         # of a neighbour's light into a cutout
_TYPICAL = Shape(0.7, np.zeros(2))       # where too few spots show one
_ELONGATED_SIGMAS, _ELONGATED_PART = 5.0, 1.0
_ODD_PART = 0.5                 # of the spots, that can not all be of another shape than theirs


@dataclass(frozen=True)
class Centroids:
    """The stars of an image, brightest first, of no part of it a crowd.

    Attributes
    ----------
    uv_raster : (n, 2) array
        Places, (0, 0) the centre of the top-left pixel [px].
    covariance : (n, 2, 2) array
        Of their errors [px^2].
    flux : (n,) array
        Light of each [counts].
    flags : (n,) uint8 array
        Sums of SATURATED, BLENDED, EDGE, ELONGATED; 0 is a clean star.
    shape : Shape
        Spot and trail that the stars have in common, in pixels of the image that was measured.
    streak : (2,) array
        Trail that the clearest detections have in common by the moments of their light, longer
        than can be fitted, too; 0 where they are round or lie any way [px].
    """

    uv_raster: Array
    covariance: Array
    flux: Array
    flags: NDArray[np.uint8]
    shape: Shape
    streak: Array

    @property
    def sigma(self) -> Array:
        """Standard deviation (n,) of a place, the mean of both axes [px]."""
        return np.sqrt(np.trace(self.covariance, axis1=-2, axis2=-1) / 2.0)


def of_picture(picture: Picture, config: CentroidConfig) -> Centroids:
    """Find and measure the stars of a picture, in pixels of its camera; as `extract`."""
    lattice = picture.lattice
    found = extract(picture.counts, config, picture.scale, lattice)
    if lattice is None:
        return found
    return replace(found, uv_raster=lattice.places(found.uv_raster),
                   covariance=lattice.covariance(found.covariance),
                   streak=lattice.vector(found.streak))


def extract(image: NDArray[np.generic], config: CentroidConfig,
            scale: Scale | None = None, lattice: Lattice | None = None) -> Centroids:
    """Find and measure the stars of an image.

    Parameters
    ----------
    image : (height, width) array
        Counts, any real type, top row first; what is not finite is not known.
    config : CentroidConfig
        Threshold, gain, saturation.
    scale : Scale, optional
        Of the counts; by default that of the type of the image.
    lattice : Lattice, optional
        Which pixels of a larger one these are, over which the spots are to be spread.

    Raises
    ------
    ValueError
        As `Light.of`.
    """
    light = Light.of(image, config.saturation_counts, scale)
    spots = find_spots(light.counts, light.noise, config.threshold)
    if not len(spots.flux):
        return Centroids(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0),
                         np.empty(0, np.uint8), _TYPICAL, np.zeros(2))

    def cutouts(row: Rows, half: int) -> tuple[Cutouts, Mask]:
        return (Cutouts.of(light, spots.uv_raster[row], half),
                _crowded(spots.uv_raster, half)[row])

    electrons = config.gain_electrons and config.gain_electrons * light.unit
    # More spots than are wanted may be a crowd of something else than stars.
    many, size, place = len(spots.flux) > config.max_spots, light.counts.shape, spots.uv_raster
    if lattice is not None:
        size, place = lattice[:2], lattice.places(place)
    row = (best(place, spots.flux, size, config.max_spots) if many
           else np.arange(len(spots.flux)))

    clearest = np.argsort(-spots.significance, kind='stable')[:_CANDIDATES]
    of_cells = clear_of_crowds(place, spots.significance, size)
    streak = trail_of(np.median(
        spots.moments[of_cells if many else clearest[:_SHAPE_SPOTS]], axis=0))

    def measured(clear: Rows, most: int) -> Centroids:
        shape, gain = _common_shape(cutouts, spots, clear, most, electrons)
        return _of_shape(*cutouts(row, shape.half), spots.take(row), shape, gain,
                         electrons is not None, light.unit, streak)

    if not many:
        found = measured(clearest, _SHAPE_SPOTS)
        if np.mean(found.flags & ELONGATED > 0) < _ODD_PART:
            return found
    # Here, too, where the clearest spots are of another shape than most, such as a line of text.
    return measured(of_cells, _CANDIDATES)


def _of_shape(cut: Cutouts, crowded: Mask, rough: Detections, shape: Shape, gain: float,
              photons: bool, unit: float, streak: Array) -> Centroids:
    """Return the centroids of spots that have a shape; `unit` is that of their light [counts]."""
    found = fit(cut, rough.uv_raster - cut.middle, shape, gain, photons)
    good = found.good
    elongated = np.linalg.eigvalsh(found.moments)[:, 1] > np.maximum(
        _ELONGATED_SIGMAS * found.moments_sigma,
        _ELONGATED_PART * np.trace(shape.moments) / 2.0)
    flags = (SATURATED * cut.saturated + BLENDED * crowded + EDGE * cut.cut
             + ELONGATED * np.where(good, elongated, ~cut.saturated))
    return Centroids(
        np.where(good[:, None], cut.middle + found.offset, rough.uv_raster),
        np.where(good[:, None, None], found.covariance, rough.moments + np.eye(2)),
        unit * np.where(good, found.flux, rough.flux), flags.astype(np.uint8), shape,
        streak)


def _common_shape(cutouts: Callable[[Rows, int], tuple[Cutouts, Mask]], spots: Detections,
                  clear: Rows, most: int, gain: float | None) -> tuple[Shape, float]:
    """Return the shape that most of some spots have, and the electrons a unit of light.

    That is of the first `most` of the rows `clear` that are clean.
    """
    if len(clear) < _LEAST_SHAPE_SPOTS:
        return _TYPICAL, gain or np.inf
    place, measured_gain = spots.uv_raster.copy(), np.inf
    shape = Shape.of_moments(np.median(spots.moments[clear], axis=0))
    for _ in range(_SHAPE_ROUNDS):
        cut, crowded = cutouts(clear, shape.half)
        clean = np.flatnonzero(~(cut.saturated | cut.cut | crowded))[:most]
        cut, row = cut.take(clean), clear[clean]
        if len(row) < _LEAST_SHAPE_SPOTS:
            break
        found = fit(cut, place[row] - cut.middle, shape, gain or measured_gain, gain is not None,
                    iterations=2)
        good = found.good
        if good.sum() < _LEAST_SHAPE_SPOTS:
            break
        place[row[good]] = (cut.middle + found.offset)[good]
        measured_gain = 1.0 / max(float(np.median(found.shot[good])), _LEAST_SHOT)
        last, shape = shape, found.shape
        if np.abs(shape.moments - last.moments).max() < _SETTLED * np.trace(shape.moments):
            break
    return shape, gain or measured_gain


def _crowded(uv_raster: Array, half: int) -> Mask:
    """Tell which spots have another one within reach of their cutout."""
    if len(uv_raster) < 2:
        return np.zeros(len(uv_raster), bool)
    distance, _ = cKDTree(uv_raster).query(uv_raster, k=2, p=np.inf)
    return distance[:, 1] < half + _NEIGHBOUR_REACH_PX
