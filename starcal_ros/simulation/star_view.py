# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the stars really are on the true detector, at one moment or while an exposure lasts."""

from __future__ import annotations

import warnings

import erfa
import numpy as np

from starcal_ros.config.models import observer
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.remembered import remembered
from starcal_ros.simulation.star_images import instants_ns
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky.apparent import Observer, apparent_places
from starcal_ros.sky.catalog import Catalog

Rows = Ints

_MARGIN = 1e-3          # rad, more than aberration and proper motion move a star
_AROUND = 1.1           # detectors: what trails into the picture, and light beside a star


class StarView:
    """The sky as the true camera sees it.

    Parameters
    ----------
    scenario : Scenario
        Observer and exposure.
    truth : Truth
        Camera, mounting and attitude.
    stars : Catalog
        The stars that are there.

    Warns
    -----
    UserWarning
        Where the distortion folds back before the edge of the detector.
    """

    def __init__(self, scenario: Scenario, truth: Truth, stars: Catalog) -> None:
        self.truth, self._stars = truth, stars
        self._direction = erfa.s2c(stars.ra, stars.dec)
        self._observer = observer(scenario.observer, scenario.truth.observer)
        self._instants_ns = instants_ns(scenario.star_tracker.exposure_s)
        field = camera.field_of_view(truth.detector, truth.intrinsics, _AROUND)
        self._cos_radius = np.cos(field.radius + _MARGIN)
        if not field.whole:
            warnings.warn('truth.camera.distortion: folds back before the edge of the detector; '
                          f'no star is seen beyond {np.degrees(field.radius):.1f} deg')

    def near(self, middle_ns: Rows) -> tuple[Rows, Rows, Array]:
        """Return the stars about the lines of sight of some frames.

        Parameters
        ----------
        middle_ns : (n_frames,) int64 array
            Middle of each exposure, UTC since the Unix epoch.

        Returns
        -------
        frame, star : (n,) int64 array
            Row of the frame and of the star in the catalogue.
        u_i : (n, 3) array
            Apparent place in the middle of the exposure.
        """
        frame, star, u_i = _near(middle_ns, self.truth.attitude_si(middle_ns), self._cos_radius,
                                 self.truth.intrinsics, self._direction, self._stars,
                                 self._observer)
        return frame, star, u_i

    def at(self, stamps_ns: Rows, frame: Rows, u_i: Array) -> Array:
        """Return the images uv (n, 2) [px] of stars of some frames, each frame at its stamp."""
        C_si = self.truth.attitude_si(stamps_ns)
        r_s = (C_si[frame] @ u_i[..., None])[..., 0]
        return camera.project(r_s, self.truth.intrinsics, self.truth.detector.pitch_mm)

    def trail(self, middle_ns: Rows, frame: Rows, u_i: Array) -> Array:
        """Return the images (5, n, 2) [px] at the `instants_ns` of the exposure."""
        return np.stack([self.at(middle_ns + instant, frame, u_i)
                         for instant in self._instants_ns])


@remembered
def _near(middle_ns: Rows, C_si: Array, cos_radius: float, intrinsics: Array, direction: Array,
          stars: Catalog, seen_by: Observer) -> tuple[Rows, Rows, Array]:
    """Return what `StarView.near` does."""
    near = C_si[:, 2, :] @ direction.T > cos_radius
    frame, star = np.divmod(np.flatnonzero(near), near.shape[1])    # nonzero of two axes is slow
    u_i = apparent_places(stars, star, middle_ns, near.sum(axis=1), seen_by)
    there = camera.unfolded((C_si[frame] @ u_i[..., None])[..., 0], intrinsics)
    return frame[there], star[there], u_i[there]
