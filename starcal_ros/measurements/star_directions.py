# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""From the messages of a star tracker to stars whose directions are known."""

from __future__ import annotations

import numpy as np

from starcal_ros.config.models import detector, observer
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.measurements.notices import Notices
from starcal_ros.measurements.samples import Frames, Stars
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places
from starcal_ros.sky.refraction import LOWEST_DEG, altitude

LEAST_SIGMA_PX = 1e-4
"""Least sigma of a centroid; below, the arithmetic of a filter ends."""

_NAMED = 20                 # stars that the catalogue lacks that are named, at most


class StarDirections:
    """Finds the stars of frames in the catalogue, as a scenario's observer sees them.

    Parameters
    ----------
    scenario : Scenario
        Its camera, observer, nominal sigma of a centroid, and what is believed of one.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._detector = detector(scenario.camera)
        tracker = scenario.star_tracker
        self._sigma = max(tracker.centroid_sigma_px, LEAST_SIGMA_PX)
        self._least = min(tracker.least_sigma_px, self._sigma)
        self._largest = max(tracker.largest_sigma_px, self._sigma)
        self._reach = 1.0 + tracker.margin      # in halves of the detector
        self._observer = observer(scenario.observer)

    def of(self, frames: Frames, notices: Notices | None = None) -> Stars:
        """Return the stars of many frames, end to end.

        Parameters
        ----------
        frames : Frames
        notices : Notices, optional
            Where it is said what can not be used.

        Returns
        -------
        stars : Stars
            Their apparent places, centroids and sigmas; sigma is infinite where no place is known
            or the centroid can not be used.
        """
        stars = catalog.load_containing(frames.catalog_id)
        row = stars.rows(frames.catalog_id)
        uv, sigma, measured = self.centroids(frames, notices)
        usable = measured & (row >= 0)
        u_i = np.tile([0.0, 0.0, 1.0], (len(uv), 1))
        u_i[usable] = apparent_places(
            stars, row[usable], frames.stamp_ns,
            np.bincount(frames.frame_index[usable], minlength=len(frames)), self._observer)
        if (site := self._observer.site) is not None:
            low = usable & (np.degrees(altitude(
                u_i, frames.stamp_ns[frames.frame_index], site)) < LOWEST_DEG)
            usable &= ~low
            if notices is not None and low.any():
                notices.once('low', f'stars lower than {LOWEST_DEG:g} deg, or under the horizon '
                             '(observer.site_deg), are unusable')
        if notices is not None:
            _name_unknown(frames.catalog_id[measured & (row < 0)], notices)
        return Stars(u_i, np.where(measured[:, None], uv, 0.0), np.where(usable, sigma, np.inf))

    def centroids(self, frames: Frames, notices: Notices | None = None
                  ) -> tuple[Array, Array, Mask]:
        """Return the centroids of frames as they can be used, identified or not.

        Returns
        -------
        uv : (n, 2) array
            From the centre of the detector [px].
        sigma : (n,) array
            Standard deviation of each axis, not less than any tracker reaches [px].
        measured : (n,) bool array
            Which can be used.
        """
        uv = frames.uv_raster - self._detector.centre_raster
        sigma = np.where(frames.sigma == 0.0, self._sigma, frames.sigma)
        on_detector = self._detector.contains(uv / self._reach)
        measured = on_detector & (sigma >= LEAST_SIGMA_PX) & (sigma <= self._largest)
        if notices is not None and not measured.all():
            self._name_unmeasured(frames, sigma, on_detector, measured, notices)
        return uv, np.where(measured, np.maximum(sigma, self._least), sigma), measured

    def _name_unmeasured(self, frames: Frames, sigma: Array, on_detector: Mask, measured: Mask,
                         notices: Notices) -> None:
        """Name the first star that is off the detector, and the first with a sigma too far off."""
        for kind, wrong, needs in (
                ('place', ~on_detector, 'a place on the detector (star_tracker.margin: '
                                        f'{self._reach - 1.0:g})'),
                ('sigma', on_detector & ~measured, f'a sigma of {LEAST_SIGMA_PX:g} to '
                                                   f'{self._largest:g} px '
                                                   '(star_tracker.largest_sigma_px)')):
            if wrong.any():
                k = int(np.argmax(wrong))
                u, v = frames.uv_raster[k]
                notices.once(kind, (
                    f'star {frames.catalog_id[k]} of the frame at '
                    f'{frames.stamp_ns[frames.frame_index[k]]} ns has u, v = {u:g}, {v:g} and '
                    f'sigma {sigma[k]:g}; needs {needs}: unusable'))


def _name_unknown(numbers: Ints, notices: Notices) -> None:
    for number in np.unique(numbers[numbers != 0])[:_NAMED].tolist():
        notices.once(number, f'star number {number} is not in the catalogue: unusable')
    if (numbers == 0).any():
        notices.once(0, 'stars without a catalogue number (catalog_id 0) are unusable')
