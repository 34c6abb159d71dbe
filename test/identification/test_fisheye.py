# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Fisheyes: identified from the middle of the field outwards, to the horizon and beyond."""

import numpy as np
import pytest

from starcal_ros.core import rotation
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.fisheye import KannalaBrandtLens
from starcal_ros.identification.fisheye_guess import FisheyeGuess
from starcal_ros.identification.identifier import Identifier
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import Observer, apparent_places

pytest.importorskip('tetra3rs')

PIXELS, LENS = Detector(640, 480, 1.0), KannalaBrandtLens(2.6)
OBSERVER = Observer('barycentre')


def frame(rng, values, faintest=4.8, sigma=0.1):
    """Return spots (raster), fluxes and numbers of what a fisheye sees of a hemisphere."""
    stars = catalog.load()
    rows = np.flatnonzero(stars.magnitude < faintest)
    r_s = apparent_places(stars, rows, [0], [len(rows)], OBSERVER) @ rotation.exp(
        3.0 * rng.standard_normal(3)).T
    uv = LENS.project(r_s, values)
    seen = (r_s[:, 2] > 0.0) & PIXELS.contains(uv)
    uv = uv[seen] + PIXELS.centre_raster + sigma * rng.standard_normal((seen.sum(), 2))
    return uv, 10.0**(-0.4 * stars.magnitude[rows[seen]]), stars.hip[rows[seen]]


def identifier(focal_px):
    return Identifier(FisheyeGuess.of_focal_length(PIXELS, focal_px, 0.08), OBSERVER)


@pytest.mark.parametrize('focal_px, k1, wrong', [
    (153.0, 0.0, 1.05), (153.0, -1.0 / 24.0, 0.95), (153.0, 1.0 / 12.0, 1.05), (300.0, 0.0, 0.95),
    (450.0, -0.02, 1.05)])
def test_stars_are_identified_to_the_edge(focal_px, k1, wrong):
    """Equidistant, equisolid, stereographic, the centre off by 2 % of the width."""
    rng = np.random.default_rng(3)
    for _ in range(3):
        values = np.array([*rng.uniform(-12.0, 12.0, 2), focal_px, k1, 0.0, 0.0, 0.0])
        uv, flux, hip = frame(rng, values, 4.8 if focal_px < 200.0 else 5.8)
        found = identifier(wrong * focal_px).lost_in_space(uv, flux, sigma=0.1)
        assert found is not None
        told = found.catalog_id != 0
        assert np.array_equal(found.catalog_id[told], hip[told])
        assert told.mean() > 0.85
        off = np.linalg.norm(uv - PIXELS.centre_raster - values[:2], axis=1)
        assert told[off > 0.9 * off.max()].mean() > 0.6, 'nor is the edge left out'
        assert found.view.intrinsics[2] == pytest.approx(focal_px, rel=0.01)


@pytest.mark.parametrize('focal_px', [153.0, 300.0])
def test_random_spots_are_no_stars(focal_px):
    rng, search = np.random.default_rng(4), identifier(focal_px)
    for count in np.tile([15, 60, 200], 7):
        uv = rng.uniform(0.0, 1.0, (count, 2)) * [PIXELS.width, PIXELS.height]
        assert search.lost_in_space(uv, rng.uniform(1.0, 100.0, count), sigma=0.2) is None


def test_the_middle_is_shown_as_a_pinhole_has_it():
    guess = FisheyeGuess.of_focal_length(PIXELS, 200.0, 0.08)
    theta = np.radians([0.0, 10.0, 39.0, 41.0])
    seen, uv = guess.flattened(200.0 * theta[:, None] * [0.6, -0.8])
    np.testing.assert_array_equal(seen, [0, 1, 2])
    np.testing.assert_allclose(uv, 200.0 * np.tan(theta[:3, None]) * [0.6, -0.8], atol=1e-9)
