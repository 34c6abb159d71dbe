# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Identified stars with the camera held: the attitude of each frame, and what is left of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from starcal_ros.calibration import bundle_adjustment, bundle_start
from starcal_ros.calibration.bundle_adjustment import Adjusted
from starcal_ros.calibration.bundle_problem import Observations
from starcal_ros.calibration.fitted_stars import FittedStars, fitted_stars
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.lenses.model import LensModel
from starcal_ros.measurements.samples import Frames, Stars
from starcal_ros.sky import catalog


class HeldFit(NamedTuple):
    """Some frames, their attitudes fitted.

    Attributes
    ----------
    spots : Observations
        Their stars.
    adjusted : Adjusted
        With the residuals.
    stars : FittedStars
        Those inside the gate, linearised.
    catalog_id : (m,) int64 array
        Numbers of the spots.
    """

    spots: Observations
    adjusted: Adjusted
    stars: FittedStars
    catalog_id: Ints


def fit(frames: Frames, stars: Stars, intrinsics: Array, lens: LensModel, gate: float,
        own_f_sigma: float = 0.0) -> HeldFit | None:
    """Fit the attitudes alone, or with their focal lengths; None where no frame has enough stars.

    Parameters
    ----------
    frames : Frames
    stars : Stars
        Their stars, as of `StarDirections.of`.
    intrinsics : (p,) array
        The camera that is held.
    lens : LensModel
        What it is.
    gate, own_f_sigma : float
        As for `bundle_adjustment.adjust`.
    """
    spots = bundle_start.identified(frames, stars)
    if not len(spots.frame):
        return None
    r_s = lens.unproject(spots.uv, intrinsics)
    adjusted = bundle_adjustment.adjust(
        spots, intrinsics, bundle_start.attitudes(spots, r_s), np.empty((0, 3)), lens,
        np.zeros((len(intrinsics),) * 2), gate, own_f_sigma)
    known = catalog.load_containing(frames.catalog_id)
    number = frames.catalog_id[bundle_start.usable(frames, stars)]
    return HeldFit(spots, adjusted, fitted_stars(
        spots, adjusted, known.magnitude[known.rows(number)], lens), number)
