# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Hot pixels: false spots that stand still on the detector.

Model
-----
The hot pixels of a run are drawn once, evenly over the detector. Each is a spot in every frame,
exactly at its pixel's centre and as bright as the faintest star that is measured.

An identifier that expects the stars gives a spot the number of the nearest one within its search
radius. So does this: a hot pixel within `SEARCH_PX` of a star carries the number that this star
has, beside the star itself; any other is not identified, number 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from starcal_ros.config.parameter import Spec
from starcal_ros.config.scenario import Scenario
from starcal_ros.measurements.samples import Frames
from starcal_ros.simulation.randomness import stream

if TYPE_CHECKING:
    from starcal_ros.sky.catalog import Catalog

GROUP = 'star_tracker'
ORDER = 80
ON = {'5 hot pixels': {'hot_pixels_per_frame': 5}}
NOTE = 'hot pixels: at fixed places in each frame.'

SEARCH_PX = 5.0
"""Search radius of the identifier."""


@dataclass(frozen=True)
class Config:
    """How many there are."""

    hot_pixels_per_frame: Annotated[int, Spec(
        'False spots in each frame, always at the same places (hot_pixels)', '', 0, 200)] = 0


def frames(scenario: Scenario, stars: Catalog) -> Callable[[Frames], Frames] | None:
    """Return the function that adds them to frames, or None where there are none."""
    return HotPixels(scenario).add if scenario.truth.of(Config).hot_pixels_per_frame else None


class HotPixels:
    """The hot pixels of one run.

    Parameters
    ----------
    scenario : Scenario
        Its detector, their number and the seed.
    """

    def __init__(self, scenario: Scenario) -> None:
        width, height = scenario.camera.width, scenario.camera.height
        pixel = stream(scenario, 'hot_pixels').choice(
            width * height, scenario.truth.of(Config).hot_pixels_per_frame, replace=False)
        self.uv_raster = np.stack((pixel % width, pixel // width), axis=-1).astype(float)
        self._sigma = scenario.star_tracker.centroid_sigma_px
        self._magnitude = scenario.star_tracker.limiting_magnitude

    def add(self, frames: Frames) -> Frames:
        """Return the frames with the hot pixels behind the stars of each."""
        count = len(self.uv_raster)
        frame = frames.frame_index
        hip = np.zeros((len(frames), count), np.int64)
        for k, place in enumerate(self.uv_raster):
            distance = np.linalg.norm(frames.uv_raster - place, axis=-1)
            near = np.flatnonzero(distance < SEARCH_PX)
            near = near[np.argsort(-distance[near])]            # the nearest is written last
            hip[frame[near], k] = frames.catalog_id[near]
        spots = Frames(frames.stamp_ns, count * np.arange(len(frames) + 1),
                       np.tile(self.uv_raster, (len(frames), 1)), np.full(hip.size, self._sigma),
                       np.full(hip.size, self._magnitude), hip.ravel())
        return _joined(frames, spots)


def _joined(a: Frames, b: Frames) -> Frames:
    """Return the stars of the same frames, those of `a` before those of `b`."""
    frame = np.concatenate([part.frame_index for part in (a, b)])
    order = np.argsort(frame, kind='stable')
    return Frames(a.stamp_ns, a.first + b.first, *(
        np.concatenate((getattr(a, name), getattr(b, name)))[order]
        for name in ('uv_raster', 'sigma', 'magnitude', 'catalog_id')))
