# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Rendered frames: light, noise and trails against what is put in."""

import dataclasses

import numpy as np
import pytest
from scipy.special import erf

from instruments import PITCH_MM
from starcal_ros.config.image import CentroidConfig, ImageConfig
from starcal_ros.config.instrument import StarTrackerConfig
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import psf
from starcal_ros.core.camera import Detector
from starcal_ros.imaging.centroids import extract
from starcal_ros.simulation.errors import smear
from starcal_ros.simulation.render import ImageSimulator, Renderer
from starcal_ros.simulation.star_images import instants_ns
from starcal_ros.simulation.star_tracker import StarTrackerSimulator
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky import catalog

DETECTOR = Detector(256, 200, PITCH_MM)
EXPOSURE_S = 0.18
NODES = np.array(instants_ns(1.0)) * 1e-9


def renderer(seed: int = 1, detector: Detector = DETECTOR, **changes) -> Renderer:
    return Renderer(ImageConfig(**changes), detector, EXPOSURE_S, np.random.default_rng(seed))


def at_rest(*uv):
    """Return trails (5, n, 2) that stand still."""
    return np.repeat(np.array([uv], float), 5, axis=0)


# Light

def test_a_spot_at_rest_is_the_gaussian_over_each_pixel():
    light = renderer().light(at_rest([10.3, -20.6]), [4.0])
    u, v = np.arange(256) - (127.5 + 10.3), np.arange(200) - (99.5 - 20.6)
    root = np.sqrt(2.0) * 0.7
    p_u, p_v = (0.5 * (erf((x + 0.5) / root) - erf((x - 0.5) / root)) for x in (u, v))
    expected = 1e6 * 0.18 * 10.0 ** -1.6 * np.outer(p_v, p_u)
    np.testing.assert_allclose(light, expected, atol=2e-6 * expected.sum())     # cut at 5 sigma


@pytest.mark.parametrize('trail', [(0.0, 0.0), (12.5, 0.0), (-4.0, 7.0)])
def test_all_the_light_of_a_star_is_drawn_about_its_place(trail):
    place = np.array([-30.2, 15.7])
    camera = renderer()
    light = camera.light(place + NODES[:, None, None] * np.array(trail), [3.0])
    assert light.sum() == pytest.approx(float(camera.electrons(3.0)), rel=1e-5)
    u, v = np.arange(256) - 127.5, np.arange(200) - 99.5
    mean = np.array([light.sum(axis=0) @ u, light.sum(axis=1) @ v]) / light.sum()
    np.testing.assert_allclose(mean, place, atol=1e-4)
    variance = np.array([light.sum(axis=0) @ (u - mean[0])**2,
                         light.sum(axis=1) @ (v - mean[1])**2]) / light.sum()
    # spot, pixel, trail
    np.testing.assert_allclose(variance, 0.7**2 + 1.0 / 12.0 + np.array(trail)**2 / 12.0,
                               rtol=1e-3)


def test_a_bent_trail_has_the_centre_that_smear_gives():
    place, speed, bend = np.array([5.0, 5.0]), np.array([8.0, 2.0]), np.array([0.0, 6.0])
    t = NODES[:, None]
    trail = (place + t * speed + t**2 * bend + t**3 * speed)[:, None]
    light = renderer().light(trail, [3.0])
    mean = np.array([light.sum(axis=0) @ (np.arange(256) - 127.5),
                     light.sum(axis=1) @ (np.arange(200) - 99.5)]) / light.sum()
    np.testing.assert_allclose(mean, smear.centroid(trail)[0], atol=1e-4)


@pytest.mark.parametrize('length', [0.0, 1.0, 6.0, 12.5, 40.0])
def test_a_trail_needs_no_more_points_than_it_has(length):
    edges = np.arange(-30.0, 31.0) - 0.2

    def profile(count):
        t, weight = psf.points(count)
        return weight @ psf.profile(edges - length * t[:, None], 0.7)

    enough = psf.count(length, 0.7)
    np.testing.assert_allclose(profile(enough), profile(4 * enough + 8), atol=2e-5
                               * profile(enough).max())


def test_slopes_of_a_profile_agree_with_central_differences():
    edges, h = np.arange(-6.0, 7.0) + 0.3, 1e-4
    first, second = psf.profile_slopes(edges, 0.8)

    def moved(by):
        return psf.profile(edges - by, 0.8)

    np.testing.assert_allclose(first, (moved(h) - moved(-h)) / (2.0 * h), atol=1e-8)
    np.testing.assert_allclose(second, (moved(h) - 2.0 * moved(0.0) + moved(-h)) / h**2,
                               atol=1e-6)


def test_a_magnitude_is_a_factor_of_2_512():
    bright, faint = renderer().electrons(np.array([3.0, 4.0]))
    assert bright / faint == pytest.approx(100.0 ** 0.2)


def test_a_star_at_the_edge_is_cut_there():
    camera = renderer()
    light = camera.light(at_rest([-128.0, 0.0], [300.0, 0.0]), [3.0, 3.0])
    assert light.sum() == pytest.approx(float(camera.electrons(3.0)) / 2.0, rel=1e-6)


# Counts

def test_counts_have_the_mean_and_variance_of_their_sources():
    camera = renderer(detector=Detector(512, 512, PITCH_MM), sky_electrons_s=400.0,
                      dark_electrons_s=100.0, read_noise_electrons=6.0, gain_electrons=2.0)
    counts = camera.counts(np.zeros((512, 512))).astype(float)
    mean, variance = 90.0 / 2.0 + 200.0, (90.0 + 36.0) / 4.0 + 1.0 / 12.0
    n = counts.size
    assert counts.mean() == pytest.approx(mean, abs=4.0 * np.sqrt(variance / n))
    assert counts.var() == pytest.approx(variance, rel=4.0 * np.sqrt(2.0 / n))


def test_starlight_has_shot_noise():
    camera = renderer(sky_electrons_s=0.0, dark_electrons_s=0.0, read_noise_electrons=0.0)
    counts = camera.counts(np.full((200, 256), 50.0)).astype(float) - 200.0
    n = counts.size
    assert counts.mean() == pytest.approx(50.0, abs=4.0 * np.sqrt(50.0 / n))
    # of a sample variance of Poisson's: (2 + 1 / mean) / n
    assert counts.var() == pytest.approx(50.0, rel=4.0 * np.sqrt((2.0 + 0.02) / n))


def test_pixels_are_full_at_the_full_well_and_counts_at_the_top():
    light = renderer().light(at_rest([0.0, 0.0]), [-5.0])
    assert renderer(full_well_electrons=1e4).counts(light).max() == 10200
    assert renderer(saturation_counts=4095).counts(light).max() == 4095
    assert renderer(full_well_electrons=1e7).counts(light).max() == 65535


def test_no_count_is_negative():
    counts = renderer(offset_counts=0.0, read_noise_electrons=50.0).counts(np.zeros((200, 256)))
    assert counts.dtype == np.uint16 and counts.min() == 0 and counts.max() < 1000


def test_hot_pixels_stay_where_they_are():
    camera = renderer(hot_pixels=40, hot_electrons_s=1e5)
    first, second = (camera.counts(np.zeros((200, 256))) > 1000 for _ in range(2))
    # 18000 electrons on average, exponentially: one in twenty-three is below 800
    assert 30 <= first.sum() <= 40
    assert (first != second).sum() <= 2


def test_the_same_seed_draws_the_same_frame():
    light = renderer().light(at_rest([0.0, 0.0]), [4.0])
    frames = [renderer(seed, hot_pixels=5).counts(light) for seed in (3, 3, 4)]
    assert np.array_equal(frames[0], frames[1]) and not np.array_equal(frames[0], frames[2])


# The simulated star tracker

def scenario(**changes) -> Scenario:
    return dataclasses.replace(Scenario(), **changes)


def simulator(scene: Scenario, config: ImageConfig, seed: int = 1) -> ImageSimulator:
    return ImageSimulator(scene, config, Truth.from_scenario(scene),
                          catalog.load(config.limiting_magnitude), np.random.default_rng(seed))


@pytest.mark.parametrize('at_s', [10.0, 60.0])
def test_images_show_the_stars_where_the_centroids_are(at_s):
    """At 10 s the camera rests, at 60 s it slews at 0.5 deg/s: trails of 6 px."""
    tracker = StarTrackerConfig(limiting_magnitude=5.5, centroid_sigma_px=0.0)
    scene = scenario(star_tracker=tracker).replace({'truth.star_tracker.smear': True})
    truth = Truth.from_scenario(scene)
    index = round(at_s * tracker.rate_hz)
    stars = StarTrackerSimulator(scene, truth, catalog.load(5.5), np.random.default_rng(1))
    frames = stars.next(index + 1)[index:index + 1]
    assert len(frames.catalog_id) > 5
    config = ImageConfig(limiting_magnitude=5.5, zero_point_electrons_s=5e6)
    image = simulator(scene, config).image(int(frames.stamp_ns[0]))
    found = extract(image, CentroidConfig(gain_electrons=1.0, saturation_counts=30000.0))
    inside = ((frames.uv_raster > 10.0) & (frames.uv_raster < 1013.0)).all(axis=1)
    miss = np.linalg.norm(frames.uv_raster[inside][:, None] - found.uv_raster, axis=-1)
    assert np.median(miss.min(axis=1)) < 0.05 and miss.min(axis=1).max() < 1.0
    # the trail of the motion: 0.5 deg/s for 0.18 s is 1.57 mrad
    length = np.linalg.norm(found.shape.trail)
    assert length == pytest.approx(0.0 if at_s == 10.0 else 6.2, abs=0.7)


def test_a_late_stamp_shows_an_earlier_sky():
    late = Scenario().replace({'truth.star_tracker.time_offset_s': 0.25})
    stamp_ns = Truth.from_scenario(Scenario()).motion.start_ns + 60 * 10**9
    config = ImageConfig(limiting_magnitude=4.0)
    on_time = simulator(Scenario(), config).image(stamp_ns)
    shifted = simulator(late, config).image(stamp_ns + 250_000_000)
    assert np.array_equal(on_time, shifted)


@pytest.mark.parametrize('rate_px_s, length', [(0.0, 0.0), (400.0, 72.0)])
def test_a_false_object_is_drawn_somewhere_else_in_each_frame(rate_px_s, length):
    stamp_ns = Truth.from_scenario(Scenario()).motion.start_ns
    dark = dict(limiting_magnitude=-2.0, sky_electrons_s=0.0, dark_electrons_s=0.0,
                read_noise_electrons=0.0)
    simulate = simulator(Scenario(), ImageConfig(false_magnitude=1.0, false_rate_px_s=rate_px_s,
                                                 full_well_electrons=1e7, **dark))
    centres = []
    for _ in range(4):
        counts = simulate.image(stamp_ns).astype(float) - 200.0
        v, u = np.nonzero(counts > 20.0)
        centres.append([u.mean(), v.mean()])
        if u.min() > 5 and u.max() < 1018 and v.min() > 5 and v.max() < 1018:
            assert np.hypot(np.ptp(u), np.ptp(v)) == pytest.approx(length + 4.0, abs=4.0)
    assert np.ptp(centres, axis=0).min() > 20.0
