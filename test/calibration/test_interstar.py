# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The method `interstar` on recordings: right, consistent, live as offline, hard to upset."""

from dataclasses import replace

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros import calibration
from starcal_ros.calibration.interstar_solver import followed, identified
from starcal_ros.calibration.methods import interstar
from starcal_ros.config.models import intrinsics
from starcal_ros.config.parameter import ConfigError
from starcal_ros.core.camera import INTRINSICS
from starcal_ros.evaluation import consistency
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.simulation import sensors

SCENARIO = TAN2018.replace({
    'simulation.duration_s': 200.0, 'motion.dwell_s': 5.0, 'intrinsics.method': 'interstar'})
TRUTH = intrinsics(SCENARIO.camera, SCENARIO.truth.camera)
SIGMA_PX = SCENARIO.star_tracker.centroid_sigma_px
METHODS = ('TCOC', 'TCWC', 'SCOC', 'SCWC')


def scenario(equations, estimate=INTRINSICS, **values):
    return SCENARIO.replace({'intrinsics.interstar_equations': equations,
                             'intrinsics.estimate': tuple(estimate), **values})


def calibrate(scenario_, frames, gyro=None):
    method = calibration.start(scenario_)
    if gyro is not None:
        method.add_gyro(gyro)
    method.add_frames(frames)
    return method.estimate()


@pytest.fixture(scope='module')
def noiseless():
    """Return frames whose centroids have no error, of a camera with and without distortion."""
    exact = {'truth.star_tracker.centroid_sigma_px': 0.0}
    return {lens: sensors.star_tracker(SCENARIO.replace(
        {**exact, 'truth.camera.distortion': lens})).next(10**6)
        for lens in ((0.0,) * 4, SCENARIO.truth.camera.distortion)}


@pytest.fixture(scope='module')
def frames():
    return sensors.star_tracker(SCENARIO).next(10**6)


@pytest.fixture(scope='module')
def gyro():
    return sensors.gyro(SCENARIO).next(10**6)


def noisy(frames, seed, sigma=SIGMA_PX):
    noise = sigma * np.random.default_rng(seed).standard_normal(frames.uv_raster.shape)
    return replace(frames, uv_raster=frames.uv_raster + noise)


@pytest.mark.slow
@pytest.mark.parametrize('equations, count', [
    ('SCWC', 3), ('SCOC', 3), ('SCOC', 5), ('SCOC', 7), ('TCWC', 7), ('TCOC', 7)])
def test_covariance_is_that_of_the_errors(noiseless, equations, count):
    """NEES over independent noises; what is not estimated is at its true value.

    SCWC with distortion knows f to 10 % only in longer recordings.
    """
    lens = SCENARIO.truth.camera.distortion if count > 3 else (0.0,) * 4
    values = {'truth.camera.distortion': lens}
    if count == 5:
        values = {'truth.camera.distortion': lens, 'camera.distortion': (0.0, 0.0, *lens[2:])}
    used, n = scenario(equations, INTRINSICS[:count], **values), 8
    truth = intrinsics(used.camera, used.truth.camera)
    nees = []
    for seed in range(n):
        found = calibrate(used, noisy(noiseless[lens], seed))
        scale = found.sigma[:count]
        error = (found.intrinsics - truth)[:count] / scale
        covariance = found.covariance[:count, :count] / np.outer(scale, scale)
        nees.append(float(error @ np.linalg.solve(covariance, error)))
        assert not found.covariance[count:].any()
        np.testing.assert_array_equal(found.intrinsics[count:], intrinsics(used.camera)[count:])
    assert float(np.mean(nees)) in consistency.mean_interval(count, n, 0.999)


@pytest.mark.parametrize('equations', METHODS)
@pytest.mark.parametrize('focal_length_mm', [23.1, 28.1])
def test_camera_may_be_known_to_ten_percent(noiseless, equations, focal_length_mm):
    """The end does not depend on the start: that is forgotten, not weighed."""
    frames = noisy(noiseless[(0.0,) * 4], 1)
    found = [calibrate(scenario(equations, INTRINSICS[:3],
                                **{'camera.focal_length_mm': f}), frames)
             for f in (25.6, focal_length_mm)]
    moved = found[1].intrinsics - found[0].intrinsics
    assert np.abs(moved[:3] / found[0].sigma[:3]).max() < 0.05
    assert np.abs((found[0].intrinsics - TRUTH)[:3] / found[0].sigma[:3]).max() < 4.5


@pytest.mark.parametrize('equations', ['SCOC', 'TCWC'])
def test_live_node_gets_what_the_recording_gives(frames, gyro, equations):
    """Frames one by one, the gyro a little later, the camera asked for now and then."""
    whole = calibrate(scenario(equations), frames, gyro)
    method, sent = calibration.start(scenario(equations)), 0
    for k in range(len(frames)):
        method.add_frames(frames[k:k + 1])
        reached = int(np.searchsorted(gyro.stamp_ns, frames.stamp_ns[k] + 3e7))
        method.add_gyro(gyro[sent:reached])
        sent = reached
        if k % 40 == 39:
            found = method.estimate()
    assert (found.frames, found.stars) == (whole.frames, whole.stars)
    assert np.abs((found.intrinsics - whole.intrinsics) / whole.sigma).max() < 0.1
    np.testing.assert_allclose(found.sigma, whole.sigma, rtol=0.02)


def test_nothing_is_said_before_there_is_something_to_say(frames):
    for equations in METHODS:
        method = calibration.start(scenario(equations))
        assert method.estimate() is None
        method.add_frames(frames[:1])
        assert method.estimate() is None if equations[0] == 'S' else True
        assert method.take_notices() == []


def test_camera_that_rests_tells_the_self_calibration_nothing():
    still = SCENARIO.replace({'motion.axes': ('x',), 'motion.angles_deg': (0.0,),
                              'motion.dwell_s': 60.0, 'simulation.duration_s': 60.0})
    assert calibrate(scenario('SCWC', ('u0', 'v0', 'f')), sensors.star_tracker(still).next(10**6)
                     ) is None


def test_wrong_numbers_and_hot_pixels_are_left_out():
    errors = {'truth.star_tracker.misidentified_fraction': 0.02,
              'truth.star_tracker.hot_pixels_per_frame': 5}
    frames = sensors.star_tracker(SCENARIO.replace(errors)).next(10**6)
    for equations in ('TCOC', 'SCOC'):
        found = calibrate(scenario(equations), frames)
        assert np.abs((found.intrinsics - TRUTH) / found.sigma).max() < 4.5


def test_noise_is_taken_from_the_residuals_where_it_makes_a_bias(noiseless):
    """SCOC, noise twice as large as stated: without a bias still, and the covariance knows."""
    clean = noiseless[SCENARIO.truth.camera.distortion]
    plain = calibrate(scenario('SCOC'), noisy(clean, 3))
    twice = calibrate(scenario('SCOC'), noisy(clean, 3, 2.0 * SIGMA_PX))
    # u0, v0: linear in the noise. f has a part of second order: the noise is not known exactly.
    np.testing.assert_allclose(twice.sigma[:2] / plain.sigma[:2], 2.0, rtol=0.1)
    assert np.abs((twice.intrinsics - TRUTH) / twice.sigma).max() < 4.5


@pytest.mark.parametrize('equations', ['TCOC', 'SCWC'])
def test_frames_that_are_not_newer_are_dropped_and_named(frames, equations):
    method = calibration.start(scenario(equations))
    method.add_frames(frames[:50])
    method.add_frames(frames[47:48])
    assert method.take_notices() == [f'frame at {frames.stamp_ns[47]} ns is not newer than the '
                                     'one before: dropped']
    assert method.take_notices() == []


def test_gyro_readings_that_can_not_be_are_dropped(frames, gyro):
    bad = GyroSamples(gyro.stamp_ns.copy(), gyro.rate.copy())
    bad.rate[100:110] = np.nan
    bad.stamp_ns[200] = 0
    used = scenario('SCWC', ('u0', 'v0', 'f'))
    found = [calibrate(used, frames, samples) for samples in (gyro, bad)]
    np.testing.assert_array_equal(found[0].intrinsics, found[1].intrinsics)


def test_frames_do_not_wait_for_a_gyro_that_has_stopped(frames, gyro):
    stopped = gyro[:2000]
    used = scenario('SCWC', ('u0', 'v0', 'f'))
    with_it, without = (calibrate(used, frames, samples) for samples in (stopped, None))
    # The last second may hold a frame that is kept.
    assert 0 <= without.frames - with_it.frames <= 1


def test_something_must_be_estimated():
    with pytest.raises(ConfigError, match='^intrinsics.estimate: got nothing, needs one'):
        calibration.start(scenario('SCWC', ()))


def test_distortion_alone_can_be_estimated(noiseless):
    used = scenario('TCOC', ('k1',), **{'camera.focal_length_mm': 25.6,
                                        'camera.principal_point_px': (5.0, 10.0),
                                        'camera.distortion': (0.0, -1e-6, 2e-5, 2e-5)})
    found = calibrate(used, noisy(noiseless[SCENARIO.truth.camera.distortion], 5))
    assert abs(found.intrinsics[3] - TRUTH[3]) < 4.0 * found.sigma[3] < 1e-6


def test_frames_far_apart_are_kept_and_frames_alike_are_not(frames):
    """0.5 deg/s at 2 Hz and 10.3 deg / 32 = 0.32 deg: every second one of a slew, none at rest."""
    found = calibrate(scenario('SCWC', ('u0', 'v0', 'f')), frames)
    slewing = 60.0 / 66.0
    assert found.frames == pytest.approx(0.5 * slewing * len(frames), rel=0.05)
    assert calibrate(scenario('TCWC'), frames).frames == len(frames)


def test_windows_hold_each_spot_in_its_place():
    uv = np.arange(14.0).reshape(7, 2)
    sigma = np.arange(1.0, 8.0)
    track = np.array([4, 9, 2, 9, 4, 9, 7])
    cuts = [(0, 3), (3, 5), (5, 7)]
    window = followed([(uv[a:b], sigma[a:b], track[a:b]) for a, b in cuts])
    assert window.seen.tolist() == [[True, True], [True, True], [False, True]]   # tracks 4 and 9
    np.testing.assert_array_equal(window.uv[window.seen], uv[[0, 1, 4, 3, 5]])
    np.testing.assert_array_equal(window.sigma[window.seen], sigma[[0, 1, 4, 3, 5]])
    places = np.eye(3)[[0, 1, 2, 0, 1, 2, 0]]
    window = identified([(uv[a:b], sigma[a:b], places[a:b]) for a, b in cuts])
    assert window.seen[:, 0].tolist() == [[True] * 3, [True, True, False], [True, True, False]]
    np.testing.assert_array_equal(window.uv[window.seen], uv)
    np.testing.assert_array_equal(window.u_i[window.seen[:, 0]], places)


def test_empty_frames_are_taken():
    empty = Frames(np.arange(3) * 10**9, np.zeros(4, np.int64), np.empty((0, 2)), np.empty(0),
                   np.empty(0), np.empty(0, np.int64))
    for equations in METHODS:
        assert calibrate(scenario(equations), empty) is None
        assert calibrate(scenario(equations), Frames.empty()) is None


def test_oldest_windows_are_forgotten(frames, monkeypatch):
    monkeypatch.setattr(interstar, 'WINDOWS', 3)
    assert calibrate(scenario('TCOC'), frames).frames < 4 * interstar.FRAMES
