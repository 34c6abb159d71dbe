# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Still images taken through the air: their centroids freed of refraction.

What refraction does to a centroid depends on attitude and camera, which are not known before.
At those of a first calibration it is right to a per cent or so, since it is small and the errors
of attitude and camera move it little; the next calibration then takes the rest away.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from starcal_ros.calibration import bundle_start
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera
from starcal_ros.core.arrays import Array, Mask
from starcal_ros.measurements.samples import Frames, Stars
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.sky.refraction import LOWEST_DEG, Site, altitude, refracted


def without_air(measured: Frames, stars: Stars, C_si: Array, intrinsics: Array,
                pitch_mm: float, site: Site) -> Frames:
    """Return frames with the centroids that they would have without air.

    Parameters
    ----------
    measured : Frames
        Centroids as measured, and the sigmas that count.
    stars : Stars
        The same stars, as far as they are freed of refraction by now.
    C_si : (n, 3, 3) array
        Attitudes that were fitted to `stars`, of each frame with stars enough.
    intrinsics : (7,) array
        The camera that was.
    pitch_mm : float
        Pixel pitch [mm].
    site : Site
        Where the images were taken.
    """
    usable = bundle_start.usable(measured, stars)
    frame = measured.frame_index[usable]
    u_i = stars.u_i[usable]
    C = C_si[np.unique(frame, return_inverse=True)[1]]

    def seen(places: Array) -> Array:
        return camera.project((C @ places[..., None])[..., 0], intrinsics, pitch_mm)

    uv = measured.uv_raster.copy()
    uv[usable] -= seen(refracted(u_i, measured.stamp_ns[frame], site)) - seen(u_i)
    return replace(measured, uv_raster=uv)


def without_low_stars(frames: Frames, scenario: Scenario, site: Site
                      ) -> tuple[Frames, Mask, int]:
    """Take the numbers from stars that are too low to know their refraction.

    Returns
    -------
    frames : Frames
        Without the numbers of those stars.
    sunk : (n,) bool array
        Frames with most of their stars below the horizon: their time or the site is wrong.
    low : int
        Stars whose number was taken.
    """
    stars = StarDirections(scenario).of(frames)
    frame = frames.frame_index
    known = np.isfinite(stars.sigma)
    height = np.full(len(frame), np.inf)
    height[known] = np.degrees(altitude(stars.u_i[known], frames.stamp_ns[frame[known]], site))
    sunk = 2.0 * np.bincount(frame, height < 0.0, len(frames)) > np.bincount(
        frame, known, len(frames))
    low = height < LOWEST_DEG
    return replace(frames, catalog_id=np.where(low, 0, frames.catalog_id)), sunk, int(low.sum())
