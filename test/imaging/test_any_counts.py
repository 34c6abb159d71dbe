# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The same sky in other counts: cut off at 0, parts of 1, with pixels that are not known, full."""

import warnings

import numpy as np
import pytest

from instruments import PITCH_MM
from starcal_ros.config.image import CentroidConfig, ImageConfig
from starcal_ros.core.camera import Detector
from starcal_ros.imaging.background import background
from starcal_ros.imaging.centroids import EDGE, SATURATED, extract
from starcal_ros.imaging.pixels import Scale
from starcal_ros.simulation.render import Renderer

PIXELS = Detector(384, 320, PITCH_MM)


def places(rng):
    """Return places of stars, from the centre [px]."""
    at = np.stack(np.meshgrid(np.arange(-160.0, 161.0, 32.0), np.arange(-128.0, 129.0, 32.0)),
                  axis=-1).reshape(-1, 2)
    return at + rng.uniform(-1.0, 1.0, at.shape)


def sky(seed, brightest=3.0, faintest=5.0, **changes):
    """Return places (raster) and counts of a rendered sky."""
    rng = np.random.default_rng(seed)
    uv = places(rng)
    camera = Renderer(ImageConfig(zero_point_electrons_s=5e6, **changes), PIXELS, 0.18, rng)
    magnitude = rng.uniform(brightest, faintest, len(uv))
    counts = camera.counts(camera.light(np.repeat(uv[None], 5, axis=0), magnitude))
    return uv + PIXELS.centre_raster, counts.astype(float)


def found(counts, uv, config=CentroidConfig(), scale=None):
    """Return the centroids, and the distance of the nearest one of each star [px]."""
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        centroids = extract(counts, config, scale)
    distance = np.linalg.norm(centroids.uv_raster[:, None] - uv, axis=-1)
    return centroids, distance


@pytest.mark.parametrize('cut', [-10.0, -4.0, 0.0, 6.0])
def test_a_sky_that_is_cut_off_keeps_its_stars(cut):
    """The offset of the counts is less than the sky: most of it is 0."""
    uv, counts = sky(1, offset_counts=0.0, sky_electrons_s=0.0, dark_electrons_s=0.0)
    rng = np.random.default_rng(2)
    counts = np.maximum(np.rint(counts + rng.normal(0.0, 8.0, counts.shape) - cut), 0.0)
    noise = background(counts.astype(np.float32), 1.0).noise
    assert noise.min() > 6.0 and noise.max() < 14.0
    centroids, distance = found(counts.astype(np.uint16), uv)
    assert distance.min(axis=0).max() < 0.3
    assert len(centroids.flux) < len(uv) + 5


@pytest.mark.parametrize('slope', [(0.25, 0.0), (0.0, -0.5), (1.0, 0.7)])
def test_the_slope_of_a_sky_is_no_noise(slope):
    """Light of a town or the Moon: standard deviations of the noise a pixel, along u and v."""
    uv, counts = sky(3, faintest=5.5)
    flat, _ = found(counts, uv)
    unit = float(np.median(background(counts.astype(np.float32)).noise))
    v, u = np.mgrid[:counts.shape[0], :counts.shape[1]]
    tilted = counts + unit * (slope[0] * u + slope[1] * v)
    sloping = background(tilted.astype(np.float32))
    assert sloping.noise.max() < 1.2 * unit
    off = sloping.level - (background(counts.astype(np.float32)).level + tilted - counts)
    assert np.abs(off).max() < 1.5 * unit           # to the edge
    centroids, distance = found(tilted, uv)
    assert abs(len(centroids.flux) - len(flat.flux)) <= 3
    assert np.median(distance.min(axis=0)) < 0.1


@pytest.mark.parametrize('top, height_px', [(30.0, 60.0), (100.0, 15.0)])
def test_the_glow_over_a_horizon_is_no_crowd_of_stars(top, height_px):
    """Its level bends within a tile: planes, and lines between the tiles, do not follow it."""
    uv, counts = sky(3, faintest=5.5)
    unit = float(np.median(background(counts.astype(np.float32)).noise))
    v = np.arange(len(counts))[:, None]
    glow = top * np.exp(np.minimum(v - 215.0, 0.0) / height_px)
    scatter = np.random.default_rng(9).normal(0.0, 0.4 * np.sqrt(glow), counts.shape)
    centroids, distance = found(counts + unit * (glow + scatter), uv)
    assert len(centroids.flux) <= len(uv) + 3
    assert (distance.min(axis=0) < 0.5).mean() > 0.95


@pytest.mark.parametrize('value', [0.0, 7.0, 0.1, 1e-9, 1e9])
def test_a_sky_without_any_noise_has_that_of_its_numbers(value):
    image = np.full((200, 200), value, np.float32)
    image[100:103, 100:103] += max(value, 1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        seen = background(image)
    assert np.isfinite(seen.noise).all() and (seen.noise > 0.0).all()
    np.testing.assert_allclose(seen.level, value, rtol=1e-6)


@pytest.mark.parametrize('scale', [1.0 / 65535.0, 1e-6, 1e6])
def test_the_unit_of_the_counts_does_not_matter(scale):
    uv, counts = sky(3)
    counts += np.random.default_rng(4).uniform(-0.5, 0.5, counts.shape)     # no steps
    one, distance = found(counts, uv)
    other, _ = found(counts * scale, uv)
    assert distance.min(axis=0).max() < 0.3
    np.testing.assert_allclose(other.uv_raster, one.uv_raster, atol=1e-3)
    np.testing.assert_allclose(other.sigma, one.sigma, rtol=1e-2)
    np.testing.assert_allclose(other.flux, one.flux * scale, rtol=1e-3)
    np.testing.assert_array_equal(other.flags, one.flags)


def test_steps_of_parts_of_one_are_noise_as_those_of_counts_are():
    """8 bits as parts of 1, the sky within one step."""
    uv, counts = sky(5)
    counts = np.clip(np.rint(counts / 60.0), 0, 255)
    of_type, _ = found(counts.astype(np.uint8), uv)
    of_one, _ = found((counts / 255.0).astype(np.float32), uv)
    assert len(of_one.flux) == len(of_type.flux)
    np.testing.assert_allclose(of_one.uv_raster, of_type.uv_raster, atol=1e-3)


@pytest.mark.parametrize('top, scale', [(4095.0, 1.0), (4095.0, 1.0 / 4095.0)])
def test_full_pixels_show_themselves(top, scale):
    """A camera of 12 bits in a file of 16, or scaled to 1."""
    uv, counts = sky(6, brightest=1.0, faintest=6.5)
    full = np.clip(counts, 0.0, top)
    truth = np.array([full[round(v) - 1:round(v) + 2, round(u) - 1:round(u) + 2].max() == top
                      for u, v in uv])
    assert 10 < truth.sum() < len(uv) - 10
    image = full * scale if scale != 1.0 else full.astype(np.uint16)
    centroids, distance = found(image, uv)
    flagged = (centroids.flags[distance.argmin(axis=0)] & SATURATED) != 0
    np.testing.assert_array_equal(flagged, truth)


def test_no_pixel_of_a_good_image_is_full():
    uv, counts = sky(7)
    centroids, _ = found(counts.astype(np.uint16), uv)
    assert not (centroids.flags & SATURATED).any()


def test_a_stated_saturation_is_that():
    uv, counts = sky(8, brightest=0.0)
    image = np.clip(counts, 0.0, 4095.0).astype(np.uint16)
    one, _ = found(image, uv, CentroidConfig(saturation_counts=65535.0))
    assert not (one.flags & SATURATED).any()
    two, _ = found(image, uv, scale=Scale(1000.0, 1.0))
    assert (two.flags & SATURATED).sum() > 30


@pytest.mark.parametrize('mark', [np.nan, np.inf, -3.4e38, 1e300])
def test_what_is_not_known_is_left_out(mark):
    """A border as registered images have, and single pixels in a star."""
    uv, counts = sky(9)
    clean, _ = found(counts, uv)
    counts[:, :70] = mark
    counts[:30] = mark
    hit = uv[60]
    counts[round(hit[1]), round(hit[0]) + 1] = mark
    centroids, distance = found(counts, uv)
    seen = (uv > [75.0, 35.0]).all(axis=1)
    assert distance.min(axis=0)[seen].max() < 0.3
    assert distance.min(axis=1).max() < 1.0, 'the border is no star'
    assert centroids.flags[distance[:, 60].argmin()] & EDGE
    good = centroids.flags == 0
    assert good.sum() > 0.9 * seen.sum() - 10
    with pytest.raises(ValueError, match='122880 pixels that are masked or not numbers'):
        extract(np.full_like(counts, mark), CentroidConfig())


def test_a_tile_of_which_nothing_is_known_has_the_level_of_its_neighbours():
    rng = np.random.default_rng(10)
    image = rng.normal(100.0, 5.0, (256, 256)).astype(np.float32)
    image[64:128, 64:192] = np.nan
    seen = background(image)
    assert np.abs(seen.level - 100.0).max() < 2.0 and np.abs(seen.noise - 5.0).max() < 1.0
    rare = np.full((256, 256), np.nan, np.float32)
    rare[1::16, 1::16] = rng.normal(100.0, 5.0, (16, 16))
    assert np.abs(background(rare).level - 100.0).max() < 2.0
