# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How many stars an identifier names, and how many wrongly: frames with false and missing stars.

A frame shows the stars of the catalogue down to a magnitude, at their apparent places, through a
true camera. Some are missing; false spots, as bright as stars, lie evenly over the detector. A
name is wrong if its spot is another star, or none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from time import process_time
from typing import NamedTuple

import erfa
import numpy as np

from starcal_ros.core import camera
from starcal_ros.core.arrays import Array, Ints
from starcal_ros.core.camera import Detector
from starcal_ros.core.rotation import to_matrix
from starcal_ros.identification.identifier import Identification
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import Observer, apparent_places

FLUX_SIGMA_MAG = 0.15
"""Scatter of a spot's brightness about the catalogue's: colours, noise [mag]."""


class SimulatedFrame(NamedTuple):
    """One frame, and the truth behind it: Hipparcos numbers (0 is false) and attitude."""

    stamp_ns: int
    uv_raster: Array
    flux: Array
    hip: Ints
    C_si: Array


@dataclass(frozen=True)
class Viewer:
    """A true camera under the sky.

    Attributes
    ----------
    detector : Detector
        Its pixels.
    intrinsics : (7,) array
        The true camera.
    rng : np.random.Generator
        Draws all that is random.
    observer : sky.Observer
        Who looks.
    limiting_magnitude, sigma_px : float
        Faintest star, Hp; error of a spot, each axis [px].
    missing : float
        Part of the stars that are not seen.
    false : int
        Spots in each frame that are no stars.
    """

    detector: Detector
    intrinsics: Array
    rng: np.random.Generator
    observer: Observer = Observer()
    limiting_magnitude: float = 6.4
    sigma_px: float = 0.05
    missing: float = 0.2
    false: int = 5

    def anywhere(self, stamp_ns: int) -> SimulatedFrame:
        """Return a frame of a random attitude."""
        q = self.rng.standard_normal(4)
        return self.at(to_matrix(q / np.linalg.norm(q)), stamp_ns)

    def at(self, C_si: Array, stamp_ns: int) -> SimulatedFrame:
        """Return the frame of an attitude."""
        stars, rng, detector = catalog.load(self.limiting_magnitude), self.rng, self.detector
        # Twice the pinhole field, or what a strong barrel draws in from further off.
        reach = max(np.arctan(detector.pitch_mm * np.hypot(detector.width, detector.height)
                              / self.intrinsics[2]),
                    camera.field_of_view(detector, self.intrinsics, 1.1).radius)
        row = np.flatnonzero(erfa.s2c(stars.ra, stars.dec) @ C_si[2] > np.cos(reach))
        u_i = apparent_places(stars, row, [stamp_ns], [len(row)], self.observer)
        uv = camera.project(u_i @ C_si.T, self.intrinsics, detector.pitch_mm)
        seen = detector.contains(uv) & (rng.random(len(row)) >= self.missing)
        row, uv = row[seen], uv[seen] + self.sigma_px * rng.standard_normal((seen.sum(), 2))
        false = np.array([detector.width, detector.height]) * (rng.random((self.false, 2)) - 0.5)
        magnitude = np.concatenate((
            stars.magnitude[row] + FLUX_SIGMA_MAG * rng.standard_normal(len(row)),
            rng.choice(stars.magnitude, self.false)))
        return SimulatedFrame(stamp_ns, np.concatenate((uv, false)) + detector.centre_raster,
                              10.0 ** (-0.4 * magnitude),
                              np.concatenate((stars.hip[row], np.zeros(self.false, np.int64))),
                              C_si)


@dataclass(frozen=True)
class Score:
    """What an identifier made of some frames.

    Attributes
    ----------
    frames, found : int
        All, and those that were identified.
    stars, named, wrong : int
        True stars in all frames, spots with a name, spots with a wrong one.
    seconds : (frames,) array
        Processor time that each took.
    """

    frames: int
    found: int
    stars: int
    named: int
    wrong: int
    seconds: Array


def score(sights: Iterable[SimulatedFrame],
          identify: Callable[[SimulatedFrame], Identification | None]) -> Score:
    """Return how an identifier does on some frames, in their order."""
    found = stars = named = wrong = 0
    seconds = []
    for sight in sights:
        begin = process_time()
        identification = identify(sight)
        seconds.append(process_time() - begin)
        stars += int(np.count_nonzero(sight.hip))
        if identification is not None:
            found += 1
            has_name = identification.catalog_id != 0
            named += int(has_name.sum())
            wrong += int((has_name & (identification.catalog_id != sight.hip)).sum())
    return Score(len(seconds), found, stars, named, wrong, np.array(seconds))
