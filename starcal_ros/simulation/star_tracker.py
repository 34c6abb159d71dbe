# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Star tracker: the stars in view at their apparent places, projected, with centroid noise.

    uv_m = project(C_si u_i) + sigma n,    n ~ N(0, I)                          (T18 Eq. 5, 6)

``u_i`` is the apparent place in the middle of the exposure, which is the frame's stamp less the
true time offset of the stamps. A star is measured where its true image falls on the detector; all
stars down to the limiting magnitude are, and all are identified, by their right numbers unless
`misidentification` is on. The sigma that a frame states is the nominal one.

The `errors` come in by their hooks: `mounting` turns C_si (`truth`), `images` moves the image and
shapes its noise, `frames` works on the finished frame.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from starcal_ros.config.models import true_time_offset_s
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Ints
from starcal_ros.measurements.samples import Frames
from starcal_ros.simulation.errors import switched_on
from starcal_ros.simulation.star_images import ImagedStars
from starcal_ros.simulation.star_view import StarView
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky.catalog import Catalog

_BATCH = 500            # frames whose stars are searched at once: 20 MB


class StarTrackerSimulator:
    """The frames of one run, in order, in batches of any size.

    Parameters
    ----------
    scenario : Scenario
        Rate, noise, limiting magnitude, observer, duration and start.
    truth : Truth
        Camera, mounting and attitude.
    stars : Catalog
        The sky, down to the limiting magnitude at least.
    rng : np.random.Generator
        The sensor's own stream; a run is the same to the bit however it is cut into batches.
    """

    def __init__(self, scenario: Scenario, truth: Truth, stars: Catalog,
                 rng: np.random.Generator) -> None:
        tracker, errors = scenario.star_tracker, scenario.truth.star_tracker
        self.count = int(scenario.simulation.duration_s * tracker.rate_hz + 1e-6)
        self.next_index = 0
        self._period_ns = 1e9 / tracker.rate_hz
        self._stated_sigma = self._sigma = tracker.centroid_sigma_px
        if errors.centroid_sigma_px is not None:
            self._sigma = errors.centroid_sigma_px
        self._late_ns = round(true_time_offset_s(scenario) * 1e9)
        self._stars = stars.brighter_than(tracker.limiting_magnitude)
        self._view = StarView(scenario, truth, self._stars)
        self._on_images = switched_on('images', scenario)
        self._on_frames = switched_on('frames', scenario, self._stars)
        self._rng = rng

    @property
    def truth(self) -> Truth:
        """Camera, mounting and attitude; may be another one for the next frames."""
        return self._view.truth

    @truth.setter
    def truth(self, truth: Truth) -> None:
        self._view.truth = truth

    def stamp_ns(self, index: np.typing.ArrayLike) -> Ints:
        """Return the stamp of the frame with an index from 0: the middle of its exposure."""
        steps = np.rint(np.asarray(index) * self._period_ns).astype(np.int64)
        return self.truth.motion.start_ns + steps

    def next(self, count: int) -> Frames:
        """Return the next frames: `count` of them, fewer at the end of the run."""
        stop = min(self.next_index + count, self.count)
        stamps = self.stamp_ns(np.arange(self.next_index, stop))
        self.next_index = stop
        return Frames.concatenate([self._observe(stamps[k:k + _BATCH])
                                   for k in range(0, len(stamps), _BATCH)])

    def _observe(self, stamps_ns: Ints) -> Frames:
        middle_ns = stamps_ns - self._late_ns
        frame, star, u_i = self._view.near(middle_ns)
        images = ImagedStars(middle_ns, frame, self._view.at(middle_ns, frame, u_i),
                             partial(self._view.trail, middle_ns, frame, u_i))
        for move in self._on_images:
            images = move(images)
        seen = self.truth.detector.contains(images.uv)
        frame, star, uv = frame[seen], star[seen], images.uv[seen]
        noise = self._rng.standard_normal(uv.shape)
        if images.noise_factor is not None:
            noise = (images.noise_factor[seen] @ noise[..., None])[..., 0]
        uv = uv + self._sigma * noise
        counts = np.bincount(frame, minlength=len(stamps_ns))
        frames = Frames(stamps_ns, np.concatenate(([0], np.cumsum(counts))),
                        uv + self.truth.detector.centre_raster,
                        np.full(len(uv), self._stated_sigma), self._stars.magnitude[star],
                        self._stars.hip[star])
        for spoil in self._on_frames:
            frames = spoil(frames)
        return frames
