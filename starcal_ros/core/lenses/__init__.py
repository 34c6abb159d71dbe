# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Lens models, one idea a file: where on the detector a direction falls, and back.

All are a `model.LensModel`. ::

    plumb_bob        T18's camera, OpenCV's k1 k2 p1 p2                     plumb_bob.py
    rational         OpenCV's k1 k2 p1 p2 k3 k4 k5 k6                       rational.py
    thin_prism       the same, and s1 s2 s3 s4
    equidistant      a fisheye of f alone                                   fisheye.py
    kannala_brandt   a fisheye of f and k1 k2 k3 k4, OpenCV's fisheye
    polynomial       a polynomial of the field, fifth order                 field_polynomial.py

`phased.PhasedLens` is any of them before pixels of which the phase is estimated.

The filter's camera is T18's alone (`starcal_ros.core.camera`).
"""

from __future__ import annotations

import numpy as np

from starcal_ros.core.arrays import Array, Mask
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.central import CentralLens
from starcal_ros.core.lenses.field_polynomial import FieldPolynomialLens
from starcal_ros.core.lenses.fisheye import EquidistantLens, KannalaBrandtLens
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.core.lenses.rational import RationalLens, ThinPrismLens

PLUMB_BOB = Tan2018Lens.name
_IN_PIXELS: tuple[type[CentralLens], ...] = (
    EquidistantLens, KannalaBrandtLens, RationalLens, ThinPrismLens, FieldPolynomialLens)
NAMES = (PLUMB_BOB, *(lens.name for lens in _IN_PIXELS))
"""All of them."""

_MARGIN = 1.15          # of the angle of a corner from the axis


def distortion(lens: LensModel, uv: Array, values: Array) -> Array:
    """Return how far a lens moves image points, (..., n, 2) [px].

    Parameters
    ----------
    lens : LensModel
    uv : (..., n, 2) array
        Where the same lens without coefficients has them, from the centre of the detector [px].
    values : (p,) array
        Of the lens model.
    """
    ideal = np.concatenate((values[:3], np.zeros(len(values) - 3)))
    return lens.project(lens.unproject(uv, ideal), values) - uv


def in_field(lens: LensModel, r_s: Array, values: Array, detector: Detector) -> Mask:
    """Tell which unit directions (n, 3) are about as near to the axis as what a detector shows.

    Beyond its corners coefficients are extrapolated, and may fold the sky back on it.
    """
    half = 0.5 * np.array([detector.width, detector.height])
    corners = lens.unproject(half * [[1, 1], [1, -1], [-1, 1], [-1, -1]], values)
    widest = float(np.arccos(np.clip(corners[:, 2].min(), -1.0, 1.0)))
    return lens.ahead(r_s) & (r_s[:, 2] > np.cos(min(_MARGIN * widest, np.pi)))


def in_pixels(name: str, detector: Detector, focal_length_px: float) -> CentralLens:
    """Return the lens model of a name other than PLUMB_BOB, for a camera.

    Parameters
    ----------
    name : str
        One of NAMES.
    detector : Detector
        Its pixels.
    focal_length_px : float
        About [px].
    """
    reach = 0.5 * float(np.hypot(detector.width, detector.height)) / focal_length_px
    found: CentralLens = {lens.name: lens for lens in _IN_PIXELS}[name](reach)
    return found
