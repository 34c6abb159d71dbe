# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Lines of right ascension and declination as a camera shows them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from starcal_ros.core import lenses
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.model import LensModel

_STEPS_DEG = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0)
_LINES = 5              # across the field, at least
_POINTS = 240           # of a line


class GridLine(NamedTuple):
    """A part of a line that lies on the detector or near it.

    Attributes
    ----------
    uv_raster : (n, 2) array
        Its points [px].
    label : str
    """

    uv_raster: Array
    label: str


def lines(C_si: Array, intrinsics: Array, lens: LensModel, detector: Detector
          ) -> Iterator[GridLine]:
    """Yield the lines of a grid of round numbers [deg] in the field of a camera.

    Parameters
    ----------
    C_si : (3, 3) array
        Attitude.
    intrinsics : (p,) array
    lens : LensModel
    detector : Detector
    """
    size = np.array([detector.width, detector.height])
    corner = size / 2.0 * [[1, 1], [1, -1], [-1, 1], [-1, -1]]
    edge = lens.unproject(corner, intrinsics)
    radius = float(np.degrees(np.arccos(np.clip(edge[:, 2].min(), -1.0, 1.0))))
    x, y, z = C_si[2]
    ra, dec = float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arcsin(z)))
    step = _round(2.0 * radius / _LINES)
    cosine = np.cos(np.radians(min(abs(dec) + radius, 90.0)))
    half = min(180.0, 1.5 * radius / max(float(cosine), 1e-3))     # of right ascension
    of_ra = _round(step / max(float(np.cos(np.radians(dec))), 0.05))

    def line(ra_deg: Array, dec_deg: Array, label: str) -> Iterator[GridLine]:
        a, d = np.radians(ra_deg), np.radians(dec_deg)
        u_i = np.stack((np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)), axis=-1)
        r_s = u_i @ C_si.T
        ahead = lenses.in_field(lens, r_s, intrinsics, detector)
        uv = lens.project(np.where(ahead[:, None], r_s, [0.0, 0.0, 1.0]), intrinsics)
        near = np.flatnonzero(ahead & (np.abs(uv) < 0.7 * size).all(axis=1))
        for part in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
            if len(part) > 1:
                yield GridLine(uv[part] + detector.centre_raster, label)

    span = np.linspace(-half, half, _POINTS) + ra
    for value in _multiples(max(dec - radius, -89.0), min(dec + radius, 89.0), step):
        yield from line(span, np.full(_POINTS, value), f'dec {value:+g}°')
    span = np.linspace(max(dec - 1.5 * radius, -90.0), min(dec + 1.5 * radius, 90.0), _POINTS)
    for value in _multiples(ra - half, min(ra + half, ra - half + 360.0 - of_ra / 2.0), of_ra):
        yield from line(np.full(_POINTS, value), span, f'RA {value % 360.0:g}°')


def _round(least: float) -> float:
    return next((step for step in _STEPS_DEG if step >= least), _STEPS_DEG[-1])


def _multiples(low: float, high: float, step: float) -> list[float]:
    return [round(k * step, 6) for k in range(int(np.ceil(low / step)),
                                              int(np.floor(high / step)) + 1)]
