# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""From the messages of a star tracker to stars with places: what every calibration begins with."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from starcal_ros.config.models import detector, observer
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.measurements.samples import Frames, Stars
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places

SIGMA_PX = (1e-4, 1e3)
"""Least and largest sigma of a centroid; outside, the arithmetic of a filter ends."""

_OUTSIDE = 1.1              # a centroid may lie this far out, in halves of the detector
_NAMED = 20                 # stars without a place that are named, at most


class Placed(NamedTuple):
    """The stars of some frames, end to end.

    Attributes
    ----------
    stars : Stars
        Their apparent places, centroids and sigmas; sigma is infinite where no place is known or
        the centroid can not be used.
    notices : list of (key, str)
        What a user should know once; a key stands for what is the same.
    """

    stars: Stars
    notices: list[tuple[object, str]]


class StarDirections:
    """Finds the stars of frames in the catalogue, as a scenario's observer sees them.

    Parameters
    ----------
    scenario : Scenario
        Its camera, observer and nominal sigma of a centroid.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._detector = detector(scenario.camera)
        self._sigma = max(scenario.star_tracker.centroid_sigma_px, SIGMA_PX[0])
        self._observer = observer(scenario.observer)

    def of(self, frames: Frames) -> Placed:
        """Return the stars of many frames."""
        stars = catalog.load_containing(frames.catalog_id)
        row = stars.rows(frames.catalog_id)
        frame = np.repeat(np.arange(len(frames)), frames.star_counts)
        uv, sigma, measured = self.centroids(frames)
        usable = measured & (row >= 0)
        u_i = np.tile([0.0, 0.0, 1.0], (len(uv), 1))
        u_i[usable] = apparent_places(
            stars, row[usable], frames.stamp_ns,
            np.bincount(frame[usable], minlength=len(frames)), self._observer)
        return Placed(
            Stars(u_i, np.where(measured[:, None], uv, 0.0), np.where(usable, sigma, np.inf)),
            [*unmeasured(frames, sigma, measured),
             *_unknown(frames.catalog_id[measured & (row < 0)])])

    def centroids(self, frames: Frames) -> tuple[Array, Array, Mask]:
        """Return the centroids of frames as they can be used, with or without a place.

        Returns
        -------
        uv : (n, 2) array
            From the centre of the detector [px].
        sigma : (n,) array
            Standard deviation of each axis [px].
        measured : (n,) bool array
            Which can be used.
        """
        uv = frames.uv_raster - self._detector.centre_raster
        sigma = np.where(frames.sigma == 0.0, self._sigma, frames.sigma)
        measured = (self._detector.contains(uv / _OUTSIDE)
                    & (sigma >= SIGMA_PX[0]) & (sigma <= SIGMA_PX[1]))
        return uv, sigma, measured


def unmeasured(frames: Frames, sigma: Array, measured: Mask) -> Iterator[tuple[object, str]]:
    """Yield the notice on the centroids that can not be used, if there are any."""
    for k in np.flatnonzero(~measured)[:1]:
        stamp_ns = frames.stamp_ns[np.searchsorted(frames.first, k, side='right') - 1]
        u, v = frames.uv_raster[k]
        yield 'star', (
            f'star {frames.catalog_id[k]} of the frame at {stamp_ns} ns has u, v = {u:g}, {v:g} '
            f'and sigma {sigma[k]:g}; needs a place on the detector and a sigma of '
            '{:g} to {:g} px: left out'.format(*SIGMA_PX))


def _unknown(numbers: Ints) -> Iterator[tuple[object, str]]:
    for number in np.unique(numbers[numbers != 0])[:_NAMED].tolist():
        yield number, f'star number {number} is not in the catalogue: left out'
    if (numbers == 0).any():
        yield 0, 'stars without a number (catalog_id 0) are left out'
