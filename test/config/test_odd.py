# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Values that are allowed and odd: each is said of its parameter, alone, with what follows."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from instruments import TAN2018
from starcal_ros.config import odd
from starcal_ros.config.scenario import Scenario
from starcal_ros.sky import catalog

CASES = [
    ({'camera.focal_length_mm': 0.8}, 'camera.focal_length_mm', '153 by 153 deg'),
    ({'camera.focal_length_mm': 25500.0, 'star_tracker.limiting_magnitude': 9.0,
      'star_tracker.smear': False}, 'camera.focal_length_mm', '0.0148 by 0.0148 deg'),
    ({'camera.pixel_pitch_mm': 0.0005, 'camera.focal_length_mm': 2.0}, 'camera.pixel_pitch_mm',
     '0.0005 mm'),
    ({'camera.principal_point_px': (512.0, 512.0)}, 'camera.principal_point_px',
     'from the centre'),
    ({'camera.distortion': (0.13, -0.01, 0.0, 0.0)}, 'camera.distortion', 'not those of OpenCV'),
    ({'gyro.arw_deg_sqrt_h': 6.0, 'estimator.initial_sigma.gyro_bias_deg_h': 1e4},
     'gyro.arw_deg_sqrt_h', '60 deg/sqrt(h)'),
    ({'gyro.bias_deg_h': (0.0, -7.2e4, 0.0)}, 'gyro.bias_deg_h', '20 deg/s'),
    ({'gyro.arw_deg_sqrt_h': 0.15}, 'estimator.initial_sigma.gyro_bias_deg_h',
     '0.1 deg/h for gyros with an angular random walk of 0.15'),
    ({'estimator.process_noise.gyro_bias_deg_h_sqrt_h': 5.0},
     'estimator.process_noise.gyro_bias_deg_h_sqrt_h', 'in minutes'),
    ({'star_tracker.exposure_s': 2.0, 'star_tracker.smear': False}, 'star_tracker.exposure_s',
     'longer than the 0.5 s'),
    ({'gyro.rate_hz': 3.0}, 'gyro.rate_hz', 'frames of 2 Hz'),
    ({'star_tracker.centroid_sigma_px': 0.0005}, 'star_tracker.centroid_sigma_px', '0.0005 px'),
    ({'star_tracker.limiting_magnitude': 3.0}, 'star_tracker.limiting_magnitude',
     '14.8 by 14.8 deg shows about 0.87'),
    ({'motion.rate_deg_s': 20.0, 'star_tracker.smear': True}, 'motion.rate_deg_s', 'px in 0.18 s'),
    ({'estimator.tolerance.k1': 1e-3}, 'estimator.tolerance.k1', 'before there are any data'),
    ({'estimator.initial_sigma.k2': 1e-3}, 'estimator.initial_sigma.k2', 'moves the corner'),
    ({'estimator.initial_sigma.focal_length_mm': 20.0}, 'estimator.initial_sigma.focal_length_mm',
     'of a focal length of 25.5 mm'),
]


@pytest.mark.parametrize('values, parameter, text', CASES, ids=[case[1] for case in CASES])
def test_an_odd_value_is_said_of_its_parameter_alone(values, parameter, text):
    found, = odd.odd(TAN2018.replace(values))
    assert found.parameter == parameter
    assert text in found.text


def test_nothing_is_odd_of_the_shipped_file_and_of_the_defaults():
    assert odd.odd(TAN2018) == odd.odd(Scenario()) == []


def test_the_stars_of_a_field_are_those_that_a_frame_shows():
    """Counted in frames of 2000 directions at random, to three of their standard errors."""
    scenario = TAN2018.replace({'camera.width': 1600, 'star_tracker.limiting_magnitude': 6.0})
    camera = scenario.camera
    sky = catalog.load(6.0)
    places = np.stack([np.cos(sky.dec) * np.cos(sky.ra), np.cos(sky.dec) * np.sin(sky.ra),
                       np.sin(sky.dec)], axis=-1)
    C_si = Rotation.random(2000, np.random.default_rng(3)).as_matrix()
    x, y, z = np.moveaxis(places @ np.swapaxes(C_si, -1, -2), -1, 0)
    half = 0.5 * camera.pixel_pitch_mm / camera.focal_length_mm
    count = ((z > 0.0) & (abs(x) < half * camera.width * z)
             & (abs(y) < half * camera.height * z)).sum(axis=1)
    assert odd.stars_in_field(scenario) == pytest.approx(
        count.mean(), abs=3.0 * count.std() / np.sqrt(len(count)))
