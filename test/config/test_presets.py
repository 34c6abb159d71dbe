# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Presets: nothing about them is odd, and an instrument of their class is calibrated with them."""

import numpy as np
import pytest
from scipy.stats import chi2

from starcal_ros import calibration
from starcal_ros.config import models, parameter_file, presets
from starcal_ros.config.new_file import new_file
from starcal_ros.config.odd import odd
from starcal_ros.config.parameter import ConfigError
from starcal_ros.core import rotation
from starcal_ros.core.units import ARCSEC
from starcal_ros.filter import verdict
from starcal_ros.filter.offline import calibrate
from starcal_ros.filter.states import CALIBRATED
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

WITH_GYROS = ('fog', 'mems', 'cubesat')


def drawn(name, duration_s):
    """Return an instrument of the class: each true value off by a draw from its initial sigma."""
    preset, rng = presets.scenario(name), np.random.default_rng(5)

    def draws(size, count):
        return tuple((size * rng.standard_normal(count)).tolist())
    sigma, walk = preset.estimator.initial_sigma, preset.estimator.process_noise
    psi = draws(sigma.fixed_angles_arcsec * ARCSEC, 3)
    C_sg = rotation.exp(np.array(psi)).T @ models.mounting_matrix(preset.mounting)
    ppm = preset.estimator.augment.gyro_matrix_sigma_ppm or 0.0
    return preset.replace({
        'simulation.duration_s': duration_s, 'motion.dwell_s': 1.0,
        'truth.camera.focal_length_mm': (
            preset.camera.focal_length_mm + draws(sigma.focal_length_mm, 1)[0]),
        'truth.camera.principal_point_px': draws(sigma.principal_point_px, 2),
        'truth.camera.distortion': tuple(
            draws(getattr(sigma, key), 1)[0] for key in ('k1', 'k2', 'p1', 'p2')),
        'truth.mounting.quaternion_xyzw': tuple(rotation.to_quaternion(C_sg).tolist()),
        'truth.gyro.bias_deg_h': draws(sigma.gyro_bias_deg_h, 3),
        'truth.gyro.bias_random_walk_deg_h_sqrt_h': walk.gyro_bias_deg_h_sqrt_h,
        'truth.gyro.scale_factor_ppm': draws(ppm, 3),
        'truth.gyro.misalignment_arcsec': draws(ppm * 1e-6 / ARCSEC, 6)})


@pytest.mark.parametrize('name', presets.PRESETS)
def test_nothing_of_a_preset_is_odd_and_its_file_gives_it_back(name):
    preset = presets.scenario(name)
    assert odd(preset) == []
    text = new_file(preset, presets.PRESETS[name].title, presets.PRESETS[name].text)
    assert parameter_file.parse(text, name) == preset
    assert max(map(len, text.splitlines()[1:])) < 100       # but the path of the schema


def test_ros_reads_the_file_of_a_preset(tmp_path):
    rclpy = pytest.importorskip('rclpy')
    path = tmp_path / 'mems.yaml'
    path.write_text(new_file(presets.scenario('mems'), 'mine'))
    context = rclpy.Context()
    rclpy.init(args=['--ros-args', '--params-file', str(path)], context=context)
    context.shutdown()


def test_t18_is_the_shipped_file_and_others_are_refused():
    assert presets.scenario('t18').camera.focal_length_mm == 25.5
    assert presets.scenario('t18').truth.camera.focal_length_mm == 25.6
    with pytest.raises(ConfigError, match="no preset 'nemo'; there are t18, fog, mems, cubesat"):
        presets.scenario('nemo')


@pytest.mark.parametrize('name', WITH_GYROS)
def test_an_instrument_of_the_class_is_calibrated(name):
    """Consistent with its sigmas after half a minute, and the focal length better by far."""
    scenario = drawn(name, 30.0)
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator, _ = calibrate(gyro.next(gyro.count), tracker.next(tracker.count), scenario)
    assert verdict.of(calibrator).word == 'not yet'
    belief, truth = calibrator.belief, Truth.from_scenario(scenario)
    error = (belief.estimate.intrinsics - truth.intrinsics) / belief.sigma[9:]
    assert error @ np.linalg.solve(
        belief.covariance[9:, 9:] / np.outer(belief.sigma[9:], belief.sigma[9:]),
        error) < chi2.isf(1e-4, 7)
    known = belief.sigma[CALIBRATED][8] / scenario.estimator.initial_sigma.focal_length_mm
    assert known < 0.05


def test_a_dslr_is_calibrated_by_its_method():
    scenario = drawn('dslr', 300.0)
    tracker = sensors.star_tracker(scenario)
    method = calibration.start(scenario)
    method.add_frames(tracker.next(tracker.count))
    estimate = method.estimate()
    truth = Truth.from_scenario(scenario).intrinsics
    assert method.judge(estimate).word == 'consistent'
    error = (estimate.intrinsics - truth) / estimate.sigma
    assert np.abs(error).max() < 4.5
    assert estimate.sigma[2] < 0.02 * scenario.estimator.initial_sigma.focal_length_mm
