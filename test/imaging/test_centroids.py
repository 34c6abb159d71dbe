# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Centroids of rendered frames against their truth and bound, of real ones against others'."""

import csv

import numpy as np
import pytest
from scipy.special import erf

from instruments import PITCH_MM, REAL_SKY
from starcal_ros.config.image import CentroidConfig, ImageConfig
from starcal_ros.core.camera import Detector
from starcal_ros.imaging.background import background
from starcal_ros.imaging.centroids import BLENDED, EDGE, ELONGATED, SATURATED, extract
from starcal_ros.imaging.cutouts import Shape
from starcal_ros.imaging.files import image_files, load
from starcal_ros.simulation.render import Renderer

DETECTOR = Detector(512, 512, PITCH_MM)
EXPOSURE_S = 0.18
NODES = np.array([-0.5, -np.sqrt(3.0 / 28.0), 0.0, np.sqrt(3.0 / 28.0), 0.5])
KNOWN = CentroidConfig(gain_electrons=1.0)


def grid(rng: np.random.Generator, spacing: int = 36):
    """Return places far from each other, at any phase, from the centre of the detector [px]."""
    at = np.arange(-220.0, 221.0, spacing)
    places = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    return places + rng.uniform(-1.0, 1.0, places.shape)


def camera_config(**changes) -> ImageConfig:
    """Return a camera of more light than the default: faint and bright stars in one frame."""
    return ImageConfig(**{'zero_point_electrons_s': 5e6, **changes})


def renderer(rng: np.random.Generator, **changes) -> Renderer:
    return Renderer(camera_config(**changes), DETECTOR, EXPOSURE_S, rng)


def along(uv, trail):
    """Return trails (5, n, 2) of steady motion through places (n, 2)."""
    return uv + NODES[:, None, None] * np.asarray(trail, float)


def measured(rng, uv, magnitude, trail=(0.0, 0.0), config=KNOWN, **changes):
    """Return what is found of stars in a rendered frame, in their order, and the errors (n, 2)."""
    camera = renderer(rng, **changes)
    found = extract(camera.counts(camera.light(along(uv, trail), magnitude)), config)
    distance = np.linalg.norm(found.uv_raster[:, None] - (uv + DETECTOR.centre_raster), axis=-1)
    of = distance.argmin(axis=0)
    assert distance[of, np.arange(len(uv))].max() < 2.0, 'a star is not found'
    return found, of, found.uv_raster[of] - uv - DETECTOR.centre_raster


def pooled(seed: int, frames: int, magnitudes, trail=(0.0, 0.0), config=KNOWN, **changes):
    """Return errors (n, 2), covariances and magnitudes of the clean stars of some frames."""
    rng, parts = np.random.default_rng(seed), []
    for _ in range(frames):
        uv = grid(rng)
        magnitude = rng.uniform(*magnitudes, len(uv))
        found, of, error = measured(rng, uv, magnitude, trail, config, **changes)
        clean = found.flags[of] == 0
        assert clean.mean() > 0.97
        parts.append((error[clean], found.covariance[of][clean], magnitude[clean]))
    return [np.concatenate(part) for part in zip(*parts)]


def whitened(error, covariance):
    return np.linalg.solve(np.linalg.cholesky(covariance), error[..., None])[..., 0]


def bound(magnitude: float, phase, config: ImageConfig):
    """Return the Cramer-Rao bound (2, 2) of a place by differences of the expected electrons.

    The light and the background are unknown too; the spot is the erf formula of the textbook,
    written here anew.
    """
    electrons = config.zero_point_electrons_s * EXPOSURE_S * 10.0 ** (-0.4 * magnitude)
    sky = (config.sky_electrons_s + config.dark_electrons_s) * EXPOSURE_S
    pixel = np.arange(-8.0, 9.0)

    def expected(x):
        u, v, light, base = x
        part = [0.5 * (erf((pixel - at + 0.5) / (np.sqrt(2.0) * config.psf_sigma_px))
                       - erf((pixel - at - 0.5) / (np.sqrt(2.0) * config.psf_sigma_px)))
                for at in (v, u)]
        return (light * np.outer(*part) + base).ravel()

    x, h = np.array([*phase, electrons, sky]), np.array([1e-4, 1e-4, 1e-2, 1e-3])
    slopes = np.stack([(expected(x + e) - expected(x - e)) / (2.0 * step)
                       for e, step in zip(np.diag(h), h)])
    # 1/12: the rounding to counts
    variance = expected(x) + config.read_noise_electrons**2 + config.gain_electrons**2 / 12.0
    return np.linalg.inv(slopes / variance @ slopes.T)[:2, :2]


# At rest

def test_errors_have_unit_variance_over_their_stated_sigma():
    error, covariance, magnitude = pooled(1, 8, (2.5, 6.5))
    z = whitened(error, covariance)
    # 2 x 1352 numbers: the variance of unit ones is 1 +- 0.03 (1 sigma).
    assert z.size > 2000 and 0.9 < z.var() < 1.1
    for faint in (magnitude < 4.5, magnitude >= 4.5):
        assert 0.86 < z[faint].var() < 1.14        # half as many numbers: 3 sigma
    assert np.abs(z).max() < 5.0


@pytest.mark.parametrize('magnitude', [3.0, 5.0, 6.3])
def test_errors_are_near_the_cramer_rao_bound(magnitude):
    error, _, _ = pooled(2, 6, (magnitude, magnitude))
    rng = np.random.default_rng(3)
    limit = np.mean([np.trace(bound(magnitude, phase, camera_config())) / 2.0
                     for phase in rng.uniform(-0.5, 0.5, (50, 2))])
    # standard deviation; 2028 numbers know it to 1.6 % (1 sigma)
    assert 0.95 < np.sqrt(np.mean(error**2) / limit) < 1.2


@pytest.mark.parametrize('psf_sigma_px', [0.5, 0.7, 1.2])
def test_there_is_no_bias_over_the_phase_of_a_pixel(psf_sigma_px):
    phases = np.arange(-0.45, 0.5, 0.1)
    uv = np.round(grid(np.random.default_rng(0), 40)) + 0.5     # on pixels' centres
    for axis in (0, 1):
        mean = []
        for k, phase in enumerate(phases):
            shifted = uv + phase * np.eye(2)[axis]
            _, _, error = measured(np.random.default_rng(k), shifted, np.full(len(uv), 3.0),
                                   psf_sigma_px=psf_sigma_px, full_well_electrons=1e6)
            mean.append(error.mean(axis=0))
        # The mean of 144 stars of 0.004 to 0.007 px is known to 0.0006 px at worst.
        assert np.abs(mean).max() < 0.01


def test_the_light_is_right_on_average():
    rng = np.random.default_rng(4)
    uv = grid(rng)
    magnitude = rng.uniform(3.0, 6.0, len(uv))
    found, of, _ = measured(rng, uv, magnitude)
    ratio = found.flux[of] / renderer(rng).electrons(magnitude)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.01)


def test_a_gain_that_is_not_known_is_measured():
    error, covariance, _ = pooled(5, 8, (2.5, 6.5), config=CentroidConfig())
    z = whitened(error, covariance)
    assert 0.9 < z.var() < 1.1


def test_a_gain_scales_counts_and_leaves_places():
    error, covariance, _ = pooled(6, 6, (2.5, 6.5), config=CentroidConfig(gain_electrons=4.0),
                                  gain_electrons=4.0)
    assert 0.9 < whitened(error, covariance).var() < 1.1


# Smear

@pytest.mark.parametrize('trail', [(12.5, 0.0), (5.0, -3.0)])
def test_a_trail_is_found_and_its_middle_measured(trail):
    """1 deg/s for 0.18 s is 12.5 px through T18's camera."""
    error, covariance, _ = pooled(7, 4, (2.5, 5.0), trail, config=KNOWN)
    z = whitened(error, covariance)
    assert 0.88 < z.var() < 1.12       # 1352 numbers: 3 sigma
    assert np.abs(error.mean(axis=0)).max() < 0.01
    rng = np.random.default_rng(8)
    shape = measured(rng, grid(rng), np.full(169, 4.0), trail)[0].shape
    assert shape.sigma == pytest.approx(0.7, abs=0.05)
    assert np.abs(shape.trail @ trail) == pytest.approx(np.dot(trail, trail), rel=0.05)


def test_a_trail_is_measured_better_than_the_mean_of_its_photons():
    """Along the trail the mean scatters by L^2 / 12 a photon; its two ends say more."""
    error, _, _ = pooled(9, 4, (3.0, 3.0), (12.5, 0.0))
    photons = float(renderer(np.random.default_rng(0)).electrons(3.0))
    assert error[:, 0].std() < 0.7 * np.sqrt((12.5**2 / 12.0 + 0.7**2) / photons)


# What is flagged

def test_a_clean_star_has_no_flag():
    found, of, _ = measured(np.random.default_rng(10), np.array([[3.3, -40.2], [90.0, 90.0],
                                                                [-100.0, 50.0]]), [4.0, 4.0, 4.0])
    assert not found.flags.any() and len(found.flux) == 3


def test_a_saturated_star_is_flagged_and_still_measured():
    rng = np.random.default_rng(11)
    uv = grid(rng)
    magnitude = np.full(len(uv), 4.0)
    magnitude[::20] = 0.5
    found, of, error = measured(rng, uv, magnitude,
                                config=CentroidConfig(gain_electrons=1.0,
                                                      saturation_counts=30100.0))
    saturated = (found.flags[of] & SATURATED).astype(bool)
    assert np.array_equal(saturated, magnitude == 0.5)
    assert np.abs(error[saturated]).max() < 0.3
    assert found.sigma[of][saturated].min() > 0.0
    # The light that the full pixels did not hold is inferred from those around.
    assert np.allclose(found.flux[of][saturated], renderer(rng).electrons(0.5), rtol=0.1)


def test_the_top_of_the_type_is_saturation():
    image = np.full((64, 64), 20, np.uint8)
    image[31:34, 31:34] = 255
    assert extract(image, CentroidConfig()).flags[0] & SATURATED


def test_neighbours_within_reach_are_flagged_as_blended():
    uv = np.array([[0.0, 0.0], [4.5, 0.0], [100.0, 100.0], [-100.0, 0.0], [0.0, 150.0]])
    found, of, _ = measured(np.random.default_rng(12), uv, np.full(5, 4.0))
    assert (found.flags[of] & BLENDED).astype(bool).tolist() == [True, True, False, False, False]


def test_a_close_pair_and_a_satellite_are_flagged_as_elongated():
    rng = np.random.default_rng(13)
    uv = grid(rng, 60)
    trail = along(uv, (0.0, 0.0))
    trail[:, 0] += NODES[:, None] * [6.0, 3.0]                      # a satellite
    trail[:, 1] = trail[:, 2] + [1.6, 0.0]                          # two stars as one
    camera = renderer(rng)
    found = extract(camera.counts(camera.light(trail, np.full(len(uv), 4.0))), KNOWN)
    at = found.uv_raster - DETECTOR.centre_raster
    flagged = [int(np.linalg.norm(at - place, axis=1).argmin())
               for place in (uv[0], uv[2] + [0.8, 0.0])]
    assert np.array_equal(np.flatnonzero(found.flags & ELONGATED), np.sort(flagged))


def test_a_star_at_the_edge_is_flagged():
    uv = np.array([[-255.0, 10.0], [0.0, 254.0], [0.0, 0.0], [100.0, 0.0]])
    found, of, error = measured(np.random.default_rng(14), uv, np.full(4, 4.0))
    assert (found.flags[of] & EDGE).astype(bool).tolist() == [True, True, False, False]
    assert np.abs(error).max() < 0.2


def test_hot_pixels_are_no_stars():
    rng = np.random.default_rng(15)
    uv = grid(rng, 60)
    camera = renderer(rng, hot_pixels=200, hot_electrons_s=2e4)
    found = extract(camera.counts(camera.light(along(uv, (0, 0)), np.full(len(uv), 5.0))), KNOWN)
    distance = np.linalg.norm(found.uv_raster[:, None] - uv - DETECTOR.centre_raster, axis=-1)
    # Two hot pixels may touch, one may lie on a star.
    assert (distance.min(axis=1) > 2.0).sum() <= 2 and (distance.min(axis=0) > 2.0).sum() <= 2


# Background and noise

def test_noise_and_background_are_those_of_the_sky():
    config = camera_config(sky_electrons_s=500.0, psf_sigma_px=1.0)
    rng = np.random.default_rng(16)
    camera = Renderer(config, DETECTOR, EXPOSURE_S, rng)
    uv = grid(rng)
    image = camera.counts(camera.light(along(uv, (0, 0)), np.full(len(uv), 4.0)))
    sky = background(image.astype(np.float32))
    mean = EXPOSURE_S * 505.0
    noise = np.sqrt(mean + 8.0**2 + 1.0 / 12.0)
    # a tile of 512 pixels knows its mean to noise / 22.6, its noise to noise / 32 (1 sigma)
    assert np.abs(sky.level - 200.0 - mean).max() < 4.0 * noise / 22.6
    assert np.abs(sky.noise / noise - 1.0).max() < 4.0 / 32.0


def test_a_slope_of_the_background_does_not_pull_the_centroids():
    rng = np.random.default_rng(17)
    uv = grid(rng)
    camera = renderer(rng)
    light = camera.light(along(uv, (0, 0)), np.full(len(uv), 4.5))
    image = camera.counts(light) + np.linspace(0.0, 400.0, 512)
    found = extract(image, CentroidConfig(gain_electrons=1.0))
    distance = np.linalg.norm(found.uv_raster[:, None] - uv - DETECTOR.centre_raster, axis=-1)
    error = (found.uv_raster[distance.argmin(axis=0)] - uv - DETECTOR.centre_raster)
    assert np.abs(error.mean(axis=0)).max() < 0.01


def test_noise_alone_shows_next_to_nothing():
    rng = np.random.default_rng(18)
    empty = [len(extract(renderer(rng).counts(np.zeros((512, 512))), KNOWN).flux)
             for _ in range(10)]
    # 262144 smoothed pixels over 5 sigma, a chance of 2.9e-7 each: 0.08 a frame
    assert sum(empty) <= 4


# Use

@pytest.mark.parametrize('image', [np.zeros((64, 64)), np.full((64, 64), 7, np.uint16)])
def test_an_image_without_stars_gives_none(image):
    found = extract(image, CentroidConfig())
    assert found.uv_raster.shape == (0, 2) and found.sigma.shape == (0,)


def test_a_single_star_is_measured():
    _, _, error = measured(np.random.default_rng(19), np.array([[10.3, -20.7]]), [3.0])
    assert np.abs(error).max() < 0.05


def test_the_brightest_spots_are_kept_first():
    rng = np.random.default_rng(20)
    uv, magnitude = grid(rng), rng.uniform(3.0, 6.0, 169)
    camera = renderer(rng)
    image = camera.counts(camera.light(along(uv, (0, 0)), magnitude))
    found = extract(image, CentroidConfig(gain_electrons=1.0, max_spots=30))
    assert len(found.flux) == 30
    assert found.flux.min() > 0.95 * camera.electrons(np.sort(magnitude)[30])


@pytest.mark.parametrize('image, text', [
    (np.zeros((8, 100)), r'image of shape \(8, 100\)'),
    (np.zeros((64, 64, 3)), r'image of shape \(64, 64, 3\)'),
    (np.full((64, 64), np.nan), '4096 pixels that are masked or not numbers')])
def test_an_impossible_image_is_refused(image, text):
    with pytest.raises(ValueError, match=text):
        extract(image, CentroidConfig())


@pytest.mark.parametrize('kind', range(5))
def test_whatever_the_image_the_numbers_are_finite(kind):
    rng = np.random.default_rng(21)
    image = [lambda: rng.normal(size=(120, 90)),                            # noise
             lambda: rng.integers(0, 256, (90, 120)).astype(np.uint8),      # full of it
             lambda: np.where(rng.random((90, 90)) < 0.5, 0, 255).astype(np.uint8),
             lambda: rng.normal(size=(120, 90)).cumsum(0).cumsum(1),        # clouds
             lambda: 100.0 * rng.standard_cauchy((70, 100))][kind]()        # cosmic rays
    for gain in (None, 1.0):
        found = extract(image, CentroidConfig(threshold=2.0, gain_electrons=gain))
        assert np.isfinite(found.uv_raster).all() and np.isfinite(found.flux).all()
        assert np.isfinite(found.sigma).all() and (found.sigma > 0.0).all()


def test_a_shape_is_that_of_its_moments():
    shape = Shape(0.8, np.array([4.0, -3.0]))
    again = Shape.of_moments(shape.moments)
    assert again.sigma == pytest.approx(0.8)
    assert np.abs(again.trail) == pytest.approx([4.0, 3.0])


# The real sky

@pytest.mark.parametrize('name', ['granasat', 'tomc16'])
def test_centroids_of_real_images_agree_with_those_of_others(name):
    if not REAL_SKY.is_dir():
        pytest.skip(f'{REAL_SKY} is not there')
    with (REAL_SKY / name / 'stars.csv').open() as stream:
        rows = list(csv.DictReader(stream))
    distance = []
    for path in image_files(REAL_SKY / name):
        picture = load(path)
        found = extract(picture.counts, CentroidConfig(max_spots=1000), picture.scale)
        uv = np.array([[row['u'], row['v']] for row in rows if row['image'] == path.name], float)
        distance.append(np.linalg.norm(found.uv_raster[:, None] - uv, axis=-1).min(axis=0))
    distance = np.concatenate(distance)
    assert np.median(distance) < 0.1
    assert np.mean(distance < 1.0) > 0.95
