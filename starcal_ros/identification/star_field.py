# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The stars that a camera should see: apparent places about a line of sight, brightest first."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import erfa
import numpy as np

from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.utc import unix_ns
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import Observer, apparent_places

_TIMELESS_NS = unix_ns('2020-01-01')
_MARGIN = 1.1           # of the detector: aberration, and what the camera is wrong by


class FieldStars(NamedTuple):
    """Stars of the catalogue, brightest first.

    Attributes
    ----------
    hip : (n,) int64 array
        Hipparcos numbers.
    u_i : (n, 3) array
        Apparent places.
    magnitude : (n,) array
        Hp.
    """

    hip: Ints
    u_i: Array
    magnitude: Array

    def take(self, rows: Mask) -> FieldStars:
        """Return some of them."""
        return FieldStars(self.hip[rows], self.u_i[rows], self.magnitude[rows])


class StarField:
    """The catalogue as an observer sees it.

    Parameters
    ----------
    observer : Observer
        Who looks, where the time is known. Without a time the places are those of 2020 without
        parallax and aberration, which would shift a field by 20" and scale it by 1e-4 at most,
        and without air.
    limiting_magnitude : float
        Faintest star, Hp.
    """

    def __init__(self, observer: Observer, limiting_magnitude: float) -> None:
        self._stars = catalog.load(limiting_magnitude)
        self._observer = observer
        self._timeless = dataclasses.replace(observer, velocity='barycentre', site=None)
        self._brightest = np.argsort(self._stars.magnitude, kind='stable')
        self._direction = erfa.s2c(self._stars.ra, self._stars.dec)[self._brightest]

    def places(self, hip: Ints, stamp_ns: int | None) -> Array:
        """Return the apparent places, (n, 3), of stars of the catalogue."""
        return self._places(self._stars.rows(hip), stamp_ns)

    def on(self, detector: Detector, lens: LensModel, C_si: Array, intrinsics: Array,
           stamp_ns: int | None, count: int) -> FieldStars:
        """Return the brightest stars that fall on a detector or near it, `count` at most."""
        corner = np.array([detector.width, detector.height]) / 2.0 * _MARGIN
        edge = lens.unproject(corner * [[1, 1], [1, -1], [-1, 1], [-1, -1]], intrinsics)
        near = np.flatnonzero(self._direction @ C_si[2] > edge[:, 2].min())
        uv = lens.project(self._direction[near] @ C_si.T, intrinsics)
        row = self._brightest[near[detector.contains(uv / _MARGIN)][:count]]
        return FieldStars(self._stars.hip[row], self._places(row, stamp_ns),
                          self._stars.magnitude[row])

    def _places(self, row: Ints, stamp_ns: int | None) -> Array:
        when, who = ((_TIMELESS_NS, self._timeless) if stamp_ns is None
                     else (stamp_ns, self._observer))
        return apparent_places(self._stars, row, [when], [len(row)], who)
