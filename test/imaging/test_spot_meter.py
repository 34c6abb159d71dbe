# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One image as one frame: which spots, where, how bright."""

import numpy as np
import pytest

from starcal_ros.config.scenario import Scenario
from starcal_ros.imaging.centroids import EDGE, ELONGATED, SATURATED, extract
from starcal_ros.imaging.spot_meter import LEFT_OUT, SpotMeter
from starcal_ros.simulation.render import Renderer

STAMP_NS = 1_782_993_600_250_000_000
SCENARIO = Scenario().replace({'camera.width': 300, 'camera.height': 200,
                               'image.gain_electrons': 2.0, 'image.saturation_counts': 4000,
                               'image.centroid.saturation_counts': 4000.0})
PLACES = np.array([[-100.0, 30.2], [-60.5, -40.0], [0.3, 0.1], [40.2, 60.7], [90.0, -20.0]])
MAGNITUDES = np.array([3.0, 4.0, 3.5, 4.5, 5.0])


def image(uv, magnitude, trail=((0.0, 0.0),)):
    """Render stars at places from the centre of the detector, with a trail each or one for all."""
    meter, tracker = SpotMeter(SCENARIO), SCENARIO.star_tracker
    camera = Renderer(SCENARIO.image, meter.detector, tracker.exposure_s, np.random.default_rng(1))
    steps = np.array([-0.5, -0.25, 0.0, 0.25, 0.5])
    uv = np.asarray(uv) + steps[:, None, None] * np.asarray(trail)
    return camera.counts(camera.light(uv, np.asarray(magnitude)))


def test_spots_are_the_stars_with_their_magnitudes_and_no_numbers():
    meter = SpotMeter(SCENARIO)
    frame, left_out = meter.measure(image(PLACES, MAGNITUDES), STAMP_NS)
    assert (len(frame), frame.stamp_ns[0], left_out) == (1, STAMP_NS, 0)
    order = np.argsort(MAGNITUDES)      # brightest first
    miss = frame.uv_raster - meter.detector.centre_raster - PLACES[order]
    assert (np.abs(miss) < 5.0 * frame.sigma[:, None]).all()
    np.testing.assert_allclose(frame.magnitude, MAGNITUDES[order], atol=0.05)
    assert not frame.catalog_id.any()


def test_a_saturated_star_stays_and_what_is_cut_or_long_goes():
    # Hp 0: 1.8e5 electrons, some 4e4 counts in the middle pixel. A satellite. A star on the edge.
    uv = np.vstack((PLACES, [[100.3, 60.4], [-30.0, 70.0], [-149.0, -70.0]]))
    trails = np.zeros((len(uv), 2))
    trails[-2] = 25.0, 8.0
    picture = image(uv, [*MAGNITUDES, 0.0, 2.0, 4.0], trails)
    flags = extract(picture, SCENARIO.image.centroid).flags
    assert {SATURATED, EDGE} <= set(flags) and (flags & ELONGATED).any()
    meter = SpotMeter(SCENARIO)
    frame, left_out = meter.measure(picture, STAMP_NS)
    assert left_out == np.count_nonzero(flags & LEFT_OUT) >= 2
    places = frame.uv_raster - meter.detector.centre_raster
    assert len(places) == len(PLACES) + 1
    miss = np.linalg.norm(places[:, None] - uv, axis=-1)
    assert set(miss.argmin(axis=1)) == {0, 1, 2, 3, 4, 5}
    assert miss[:, 5].min() < 0.1


def test_spots_of_a_mosaic_are_in_pixels_of_the_camera():
    scenario = SCENARIO.replace({'image.psf_sigma_px': 1.4})
    meter = SpotMeter(scenario)
    camera = Renderer(scenario.image, meter.detector, scenario.star_tracker.exposure_s,
                      np.random.default_rng(1))
    mosaic = camera.counts(camera.light(np.repeat(PLACES[None], 5, axis=0), MAGNITUDES)) * 1.0
    mosaic[::2, ::2] *= 0.6
    mosaic[1::2, 1::2] *= 0.4
    frame, _ = meter.measure(mosaic.astype(np.uint16), STAMP_NS, 'BGGR')
    miss = frame.uv_raster - meter.detector.centre_raster - PLACES[np.argsort(MAGNITUDES)]
    assert (np.abs(miss) < 4.0 * frame.sigma[:, None]).all() and frame.sigma.max() < 0.2


def test_a_dark_image_is_a_frame_without_spots():
    frame, left_out = SpotMeter(SCENARIO).measure(image(np.empty((0, 2)), []), STAMP_NS)
    assert len(frame) == 1 and not len(frame.uv_raster) and left_out == 0


def test_without_an_exposure_there_is_no_zero_point_and_no_magnitude():
    meter = SpotMeter(SCENARIO.replace({'star_tracker.exposure_s': 0.0}))
    frame, _ = meter.measure(image(PLACES, MAGNITUDES), STAMP_NS)
    assert len(frame.magnitude) == 5 and np.isnan(frame.magnitude).all()


def test_an_image_of_another_size_is_refused():
    with pytest.raises(ValueError, match='200 x 300 pixels, the camera has 300 x 200'):
        SpotMeter(SCENARIO).measure(image(PLACES, MAGNITUDES).T, STAMP_NS)


def test_by_default_a_full_pixel_is_a_saturated_one():
    """A full well below the top of the counts would hide it: Arcturus, clipped and believed."""
    scenario = Scenario().replace({'camera.width': 300, 'camera.height': 200})
    meter, config = SpotMeter(scenario), scenario.image
    camera = Renderer(config, meter.detector, scenario.star_tracker.exposure_s,
                      np.random.default_rng(1))
    picture = camera.counts(camera.light(
        np.repeat(PLACES[None], 5, axis=0), np.array([-1.5, *MAGNITUDES[1:]])))
    spots = extract(picture, config.centroid)
    assert spots.flags[0] == SATURATED and not spots.flags[1:].any()
    frame, _ = meter.measure(picture, STAMP_NS)
    miss = frame.uv_raster[0] - meter.detector.centre_raster - PLACES[0]
    assert (np.abs(miss) < 4.0 * frame.sigma[0]).all()
