# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Every other pixel as an image of its own: each in its place, and stars measured as well."""

import numpy as np
import pytest

from instruments import PITCH_MM
from starcal_ros.config.image import CentroidConfig, ImageConfig
from starcal_ros.core.camera import Detector
from starcal_ros.imaging.centroids import of_picture
from starcal_ros.imaging.lattice import Lattice
from starcal_ros.imaging.picture import Picture, Plane
from starcal_ros.imaging.pixels import Scale
from starcal_ros.simulation.render import Renderer


@pytest.mark.parametrize('odd', [0, 1])
@pytest.mark.parametrize('height, width', [(48, 64), (47, 64), (48, 63), (5, 7), (2, 31), (31, 2)])
def test_each_pixel_knows_its_place(height, width, odd):
    lattice, (v, u) = Lattice(height, width, odd), np.indices((height, width)) * 1.0
    mine = (u + v) % 2 == odd
    of_u, of_v = (lattice.of(each, np.nan) for each in (u, v))
    row, column = np.nonzero(np.isfinite(of_u))
    assert len(row) == mine.sum()
    np.testing.assert_array_equal(
        lattice.places(np.stack((column, row), axis=1) * 1.0),
        np.stack((of_u[row, column], of_v[row, column]), axis=1))
    for at, size in ((row, of_u.shape[0]), (column, of_u.shape[1])):
        assert set(at) == set(range(size)), 'no empty row or column'
    image = 100.0 * v + u
    shown = lattice.shown(lattice.of(image, np.nan))
    np.testing.assert_array_equal(shown[mine], image[mine])
    assert np.abs(shown - image).max() == 1.0, 'of the next one in the row'


def test_vectors_and_covariances_turn_with_places():
    lattice, C = Lattice(48, 64, 1), np.array([[2.0, 0.5], [0.5, 1.0]])
    step = np.array([0.3, -0.2])
    origin, moved = lattice.places(np.stack((np.zeros(2), step)))
    np.testing.assert_allclose(moved - origin, lattice.vector(step), atol=1e-12)
    root = np.linalg.cholesky(C)
    axes = np.stack([lattice.vector(axis) for axis in root.T])
    np.testing.assert_allclose(lattice.covariance(C[None])[0], axes.T @ axes)


@pytest.mark.parametrize('pattern', ['RGGB', 'GRBG'])
def test_stars_behind_a_mosaic_are_where_they_are_and_as_well_known_as_it_says(pattern):
    """Of the PSF of T18, s = 0.7 px, of which the mean of two green pixels is too coarse."""
    pixels, rng, z = Detector(400, 360, PITCH_MM), np.random.default_rng(5), []
    camera = Renderer(ImageConfig(zero_point_electrons_s=2e6), pixels, 0.3, rng)
    for _ in range(4):
        uv = np.stack(np.meshgrid(np.arange(-176.0, 177.0, 32.0), np.arange(-144.0, 145.0, 32.0)),
                      axis=-1).reshape(-1, 2)
        uv += rng.uniform(-4.0, 4.0, uv.shape)
        light = camera.light(np.repeat(uv[None], 5, axis=0), rng.uniform(2.0, 6.0, len(uv)))
        for row in (0, 1):
            for column in (0, 1):
                colour = pattern[2 * row + column]
                light[row::2, column::2] *= {'R': 0.6, 'G': 1.0, 'B': 0.4}[colour]
        counts = camera.counts(light)
        found = of_picture(Picture.of(Plane(counts, Scale.of(counts.dtype), None, pattern)),
                           CentroidConfig())
        miss = found.uv_raster[:, None] - pixels.centre_raster - uv
        nearest = np.linalg.norm(miss, axis=-1).argmin(axis=1)
        clean = found.flags == 0
        z.append((miss[np.arange(len(nearest)), nearest] / found.sigma[:, None])[clean])
        assert clean.sum() > 0.9 * len(uv)
    z = np.concatenate(z)
    assert 0.9 < np.sqrt(np.mean(z**2)) < 1.15
    assert np.abs(z.mean(axis=0)).max() < 4.0 / np.sqrt(len(z))
