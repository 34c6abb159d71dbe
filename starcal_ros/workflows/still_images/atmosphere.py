# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Still images taken through the air: stars that are too low in it, or under the ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Mask
from starcal_ros.measurements.samples import Frames
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.sky.refraction import LOWEST_DEG, Site, altitude


def without_low_stars(frames: Frames, scenario: Scenario, site: Site
                      ) -> tuple[Frames, Mask, int]:
    """Take the numbers from stars that are too low to know their refraction.

    Parameters
    ----------
    frames : Frames
    scenario : Scenario
        Without a site of its own: it says where the stars are, not where they are seen.
    site : Site

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
