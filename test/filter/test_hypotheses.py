# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What is left out of a model on purpose is found, with its size; what is right is let alone."""

from dataclasses import replace

import numpy as np
import pytest

from instruments import TAN2018, calibrated, failed
from starcal_ros.core import camera, rotation
from starcal_ros.core.statistic import ALARM
from starcal_ros.core.units import ARCSEC, DEG_PER_HOUR, NS
from starcal_ros.filter.allowances import HARM
from starcal_ros.filter.frame_innovation import CELLS, cell_of
from starcal_ros.filter.hypotheses import CELL, CHANGING, HYPOTHESES, largest
from starcal_ros.filter.model_tests import LEAST
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.simulation.truth import Truth

SCENARIO = TAN2018.replace({'simulation.duration_s': 450.0, 'motion.dwell_s': 5.0,
                            'estimator.answer_changes': False})
HOUR = 3600.0
TRUTH = Truth.from_scenario(SCENARIO)


def fitted(settings=None, spoil=None):
    """Return the calibrator, and the sizes that fit, after some minutes."""
    calibrator = calibrated(SCENARIO, SCENARIO.replace(settings or {}), spoil)
    return calibrator, calibrator.consistency._fit()


def moved(change):
    """Return what moves the centroids by change(uv from the middle, frames) pixels."""
    def spoil(gyro, frames):
        uv = frames.uv_raster - TRUTH.detector.centre_raster
        return gyro, replace(frames, uv_raster=frames.uv_raster + change(uv, frames))
    return spoil


def along_u(values):
    return np.stack((values, np.zeros_like(values)), axis=-1)


def turned_camera(frames, theta):
    """Return the centroids of a camera turned by theta, (3,) or (n_stars, 3), in s."""
    middle, pitch = TRUTH.detector.centre_raster, TRUTH.detector.pitch_mm
    r_s = camera.unproject(frames.uv_raster - middle, TRUTH.intrinsics, pitch)
    r_s = (rotation.exp(np.broadcast_to(theta, r_s.shape)) @ r_s[..., None])[..., 0]
    return middle + camera.project(r_s, TRUTH.intrinsics, pitch)


def bias_grows(gyro, frames):
    hours = (gyro.stamp_ns - gyro.stamp_ns[0]) * (NS / HOUR)
    return GyroSamples(gyro.stamp_ns, gyro.rate + np.outer(
        hours, [0.0, 1.0 * DEG_PER_HOUR, 0.0])), frames


def tracker_turns(gyro, frames):
    hours = ((frames.stamp_ns - frames.stamp_ns[0]) * (NS / HOUR))[frames.frame_index]
    return gyro, replace(frames, uv_raster=turned_camera(
        frames, np.outer(hours, [0.0, 0.0, 200.0 * ARCSEC])))


def gyros_turn(gyro, frames):
    hours = (gyro.stamp_ns - gyro.stamp_ns[0]) * (NS / HOUR)
    # A turn of the gyros by delta in g is one of the mounting by -C_sg delta in s.
    delta = -np.outer(hours, TRUTH.C_sg.T @ [200.0 * ARCSEC, 0.0, 0.0])
    return GyroSamples(gyro.stamp_ns, (rotation.exp(delta) @ gyro.rate[..., None])[..., 0]), frames


def camera_grows(gyro, frames):
    hours = ((frames.stamp_ns - frames.stamp_ns[0]) * (NS / HOUR))[frames.frame_index]
    uv = frames.uv_raster - TRUTH.detector.centre_raster - TRUTH.intrinsics[:2]
    return gyro, replace(frames, uv_raster=frames.uv_raster + uv * (
        20e-3 * hours / TRUTH.intrinsics[2])[:, None])


def corner(uv):
    return uv / np.hypot(TRUTH.detector.width / 2, TRUTH.detector.height / 2)


CASES = {
    'time offset of the frames': (
        {'truth.star_tracker.time_offset_s': 0.003}, None, [-3.0]),
    'gyro scale factors': ({'truth.gyro.scale_factor_ppm': (200.0, -150.0, 80.0)}, None,
                           [200.0, -150.0, 80.0]),
    'velocity of the observer': ({'truth.observer.velocity': 'barycentre'}, None, None),
    'lens terms that the model lacks': (
        {}, moved(lambda uv, _: 3.0 * corner(uv) * np.sum(corner(uv)**2, axis=-1,
                                                          keepdims=True)**3), [3.0, 0.0, 0.0]),
    'pixel phase along u': (
        {}, moved(lambda uv, _: along_u(0.03 * np.sin(2 * np.pi * uv[:, 0]))), [0.03, 0.0]),
    'pixel phase along v': (
        {}, moved(lambda uv, _: along_u(-0.03 * np.cos(2 * np.pi * uv[:, 1]))[:, ::-1]),
        [0.0, -0.03]),
    'displacement with the magnitude': (
        {}, moved(lambda uv, frames: along_u(0.02 * (frames.magnitude - 5.0))), [0.02, 0.0]),
    'drift of the gyro bias': ({}, bias_grows, [0.0, 1.0, 0.0]),
    'drift of the mounting of the star tracker': (
        {}, tracker_turns, [0.0, 0.0, 200.0]),
    'drift of the mounting of the gyros': ({}, gyros_turn, [200.0, 0.0, 0.0]),
    'drift of the camera': ({}, camera_grows, [0.0, 0.0, 20.0]),
    'cell 2, 3 of the detector': (
        {}, moved(lambda uv, _: along_u(0.05 * (cell_of(uv, 512.0) == 6))), [0.05, 0.0]),
}


@pytest.mark.slow
@pytest.mark.parametrize('name', CASES)
def test_an_effect_that_the_model_lacks_is_found_with_its_size(name):
    settings, spoil, size = CASES[name]
    calibrator, fit = fitted(settings, spoil)
    k = [each.name for each in HYPOTHESES].index(name)
    told = 'displacement in the worst cell' if CELL.start <= k < CELL.stop else name
    assert told in failed(calibrator)
    if size is None:        # the Earth's velocity about the Sun was left out
        assert np.linalg.norm(fit.p[k]) == pytest.approx(29.3, abs=1.0)
    else:
        n = len(size)
        # To the sigma of the fit, and to a twentieth: the effects are linear only to that.
        assert np.abs(fit.p[k][:n] - size).max() < 5 * fit.sigma[k][:n].max() + 0.05 * np.abs(
            size).max()
    # Nothing that is thought of explains the innovations as well.
    rivals = np.delete(fit.gain[:len(HYPOTHESES)], k)
    assert fit.gain[k] > rivals.max()
    statistic, = (each for each in calibrator.consistency.statistics() if each.name == told)
    assert statistic.fits and 'sigma' in statistic.fits


def test_misalignments_of_the_gyros_are_found():
    M = 1e-6 * np.array([[0.0, 150.0, 0.0], [150.0, 0.0, -60.0], [0.0, -60.0, 0.0]])
    calibrator, fit = fitted(spoil=lambda gyro, frames: (
        GyroSamples(gyro.stamp_ns, gyro.rate @ (np.eye(3) + M).T), frames))
    k = [each.name for each in HYPOTHESES].index('gyro misalignments')
    np.testing.assert_allclose(fit.p[k], [150.0, 0.0, -60.0], atol=15.0)
    assert 'gyro misalignments' in failed(calibrator)


def test_of_a_right_model_each_size_is_nought_within_its_sigma():
    calibrator, fit = fitted()
    assert failed(calibrator) == set()
    told = np.isfinite(fit.sigma[:len(HYPOTHESES)])
    ratio = (fit.p / fit.sigma)[:len(HYPOTHESES)][told]
    assert np.abs(ratio).max() < 4.5 and ratio.std() == pytest.approx(1.0, abs=0.3)


def test_an_effect_that_does_no_harm_does_not_count():
    """A time offset of 0.18 ms is told by 5 of its sigmas and shifts no state by half of one."""
    calibrator, fit = fitted({'truth.star_tracker.time_offset_s': 0.00018})
    assert fit.p[0, 0] / fit.sigma[0, 0] < -4.0
    assert failed(calibrator) == set()
    assert HARM < 1.0 and ALARM < 1e-3 and LEAST > 0


def test_the_cells_cover_the_detector_and_each_effect_has_its_numbers():
    uv = np.stack(np.meshgrid(np.linspace(-600, 600, 50), np.linspace(-600, 600, 50)), axis=-1)
    cells = cell_of(uv, np.array([512.0, 512.0]))
    assert set(cells.ravel().tolist()) == set(range(CELLS * CELLS))
    assert cells[0, 0] == 0 and cells[-1, -1] == CELLS**2 - 1 and cells[0, -1] == CELLS - 1
    assert ((largest() > 0).sum(axis=1) == [len(each.numbers) for each in HYPOTHESES]).all()
    assert len(CHANGING) == 4
