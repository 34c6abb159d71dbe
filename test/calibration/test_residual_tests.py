# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the residuals: their distribution where the model is right, and what they find."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import f as fisher, kstest

from instruments import INTRINSICS, PITCH_MM, TAN2018
from starcal_ros import calibration
from starcal_ros.calibration import camera_verdict, residual_tests
from starcal_ros.calibration.bundle_adjustment import adjust
from starcal_ros.calibration.bundle_problem import Observations
from starcal_ros.calibration.fitted_stars import fitted_stars
from starcal_ros.calibration.frame_sample import FrameSample
from starcal_ros.core import camera, rotation
from starcal_ros.core.camera import INTRINSICS_SCALE, Detector
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.core.statistic import gated_nis
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.simulation import sensors

LENS = Tan2018Lens(PITCH_MM)
DETECTOR, SIGMA, GATE = Detector(1024, 1024, PITCH_MM), 0.05, 18.42
PRIOR = np.diag(np.array([20.0, 20.0, 2.5, 1e-3, 1e-5, 1e-4, 1e-4])**2)
HALF = 512.0 * np.sqrt(2.0)
PATTERNS = (residual_tests.LENS, residual_tests.CELLS, residual_tests.PHASE, residual_tests.TIME)


def scene(rng, frames=60, stars=25, noise=lambda uv: 1.0, move=lambda uv, frame: 0.0, wrong=0.0,
          stated=SIGMA, still=False):
    """Return the stars of frames, wherever they look, as an adjustment leaves them."""
    frame = np.repeat(np.arange(frames), stars)
    uv = rng.uniform(-512.0, 512.0, (stars if still else frames * stars, 2))
    uv = np.tile(uv, (frames, 1)) if still else uv
    C_si = rotation.exp(0.0 * frame[:frames, None] + (
        np.zeros(3) if still else rng.standard_normal((frames, 3))))
    u_i = (np.swapaxes(C_si[frame], -1, -2)
           @ camera.unproject(uv, INTRINSICS, PITCH_MM)[..., None])[..., 0]
    sigma = SIGMA * noise(uv) * np.ones(len(uv))
    measured = uv + sigma[:, None] * rng.standard_normal(uv.shape) + move(uv, frame)
    lost = rng.random(len(uv)) < wrong
    measured[lost] += rng.uniform(-50.0, 50.0, (lost.sum(), 2))
    spots = Observations(frame, measured, np.full(len(uv), stated), u_i, np.full(len(uv), -1))
    return fit(spots, C_si)


def fit(spots, C_si):
    """Return the stars and the camera of an adjustment that begins at the truth."""
    adjusted = adjust(spots, INTRINSICS, C_si, np.empty((0, 3)), LENS, PRIOR, GATE)
    estimate = CameraEstimate(adjusted.intrinsics, adjusted.covariance, len(C_si),
                              int(adjusted.used.sum()))
    magnitude = np.linspace(0.0, 6.0, len(spots.frame))
    return fitted_stars(spots, adjusted, magnitude, LENS), estimate


def judged(stars, estimate, **options):
    return residual_tests.consistency(stars, estimate, DETECTOR, gated_nis(0.9999), **options)


def failed(found):
    return {each.name for each in found.failed}


@pytest.mark.slow
@pytest.mark.parametrize('still', [False, True])
def test_patterns_have_the_distribution_that_is_stated_where_the_model_is_right(still):
    """At rest, too, where each star stays at its place in the pixel."""
    rng, chances, alarms = np.random.default_rng(11), {name: [] for name in PATTERNS}, 0
    for _ in range(150):
        found = judged(*scene(rng, frames=20, stars=20, still=still))
        alarms += bool(found.failed)
        freedom = found.statistics[0].samples
        for each in found.statistics:
            if each.name in chances:
                chances[each.name].append(fisher.sf(
                    each.value, each.samples, freedom - each.samples))
    assert alarms == 0
    for name, chance in chances.items():
        assert len(chance) == 150 and kstest(chance, 'uniform').pvalue > 1e-3, name


def test_level_has_the_freedom_of_what_was_fitted():
    """The rank of the whole design matrix, and the squares that its projection leaves."""
    stars, estimate = scene(np.random.default_rng(2), frames=6, stars=9)
    n = len(stars.frame)
    of_frame = np.eye(6)[stars.frame]
    H = np.concatenate(((of_frame[:, None, :, None] * stars.by_attitude[:, :, None, :]).reshape(
        2 * n, -1), stars.by_camera.reshape(2 * n, -1)), axis=1)
    H = H / np.linalg.norm(H, axis=0)
    level = judged(stars, estimate).statistics[0]
    assert level.samples == 2 * n - np.linalg.matrix_rank(H) == 2 * n - 18 - 7
    z = stars.z.reshape(-1)
    left = z - H @ np.linalg.lstsq(H, z, rcond=None)[0]
    assert level.value == pytest.approx(left @ left / level.samples / gated_nis(0.9999), rel=1e-6)
    assert level.low < 1.0 / 1.2 and level.high > 1.2


def test_any_camera_near_the_best_gives_the_same_tests():
    """The residuals of a camera that is three sigmas off, its error projected out."""
    stars, estimate = scene(np.random.default_rng(3))
    off = 3.0 * np.linalg.cholesky(estimate.covariance)[:, 2] / INTRINSICS_SCALE
    moved = stars._replace(z=stars.z - stars.by_camera @ off)
    for one, other in zip(judged(stars, estimate).statistics, judged(moved, estimate).statistics):
        if one.name != residual_tests.AGREEMENT:
            assert one.value == pytest.approx(other.value, rel=1e-6), one.name


@pytest.mark.parametrize('name, what', [
    (residual_tests.LENS, {'move': lambda uv, _: 1.5 * uv / HALF * np.sum(
        (uv / HALF)**2, axis=1, keepdims=True)**3 * 2.0}),
    (residual_tests.PHASE, {'move': lambda uv, _: 0.02 * np.sin(2.0 * np.pi * (uv + 511.5))}),
    (residual_tests.CELLS, {'move': lambda uv, _: 0.15 * (
        np.abs(uv - 200.0).max(axis=1, keepdims=True) < 100.0)}),
    (residual_tests.TIME, {'move': lambda uv, frame: 1.5e-4 * uv * (frame >= 30)[:, None]}),
    (residual_tests.LEVEL, {'noise': lambda uv: 2.0}),
    (residual_tests.LEVEL, {'stated': 2.0 * SIGMA}),
    (residual_tests.SCATTER_CELLS, {
        'frames': 200, 'noise': lambda uv: 0.3 + 2.0 * np.linalg.norm(uv, axis=1) / HALF}),
    (residual_tests.SCATTER_CELLS, {
        'frames': 200, 'noise': lambda uv: np.where(uv.min(axis=1) > 256.0, 3.0, 1.0)}),
    (residual_tests.REJECTIONS, {'wrong': 0.35}),
])
def test_what_is_wrong_is_found_and_named(name, what):
    for seed in range(3):
        assert name in failed(judged(*scene(np.random.default_rng(seed), **what)))


@pytest.mark.parametrize('what', [
    {'wrong': 0.1}, {'stated': 0.95 * SIGMA}, {'stated': 1.05 * SIGMA}, {'stars': 6},
    {'noise': lambda uv: 1.0 + 0.1 * uv[:, 0] / 512.0}])
def test_what_does_no_harm_is_let_pass(what):
    for seed in range(3):
        found = judged(*scene(np.random.default_rng(seed), **what))
        assert found.statistics and not found.failed
        assert found.camera_factors == (1.0,) * 7


def test_scaled_sigmas_hold_the_error_that_an_unmodelled_term_makes():
    stars, estimate = scene(np.random.default_rng(1), move=lambda uv, _: 1.5 * uv / HALF * np.sum(
        (uv / HALF)**2, axis=1, keepdims=True)**3)
    error = np.abs(estimate.intrinsics - INTRINSICS) / estimate.sigma
    assert error.max() > 20.0
    assert (error < 3.5 * np.sqrt(judged(stars, estimate).camera_factors)).all()


def test_a_method_that_promises_too_much_is_told_by_the_stars():
    stars, estimate = scene(np.random.default_rng(4))
    off = 10.0 * np.linalg.cholesky(estimate.covariance)[:, 2] / INTRINSICS_SCALE
    moved = stars._replace(z=stars.z - stars.by_camera @ off)
    found = judged(moved, estimate)
    assert failed(found) == {residual_tests.AGREEMENT}
    assert min(found.camera_factors) > 2.0
    honest = replace(estimate, covariance=100.0 * estimate.covariance)
    assert not judged(moved, honest).failed


def test_an_unstated_sigma_is_not_judged():
    found = judged(*scene(np.random.default_rng(5), noise=lambda uv: 3.0), margin=None)
    assert not found.failed and found.centroid_factor is None
    assert residual_tests.LEVEL not in {each.name for each in found.statistics}


def test_held_out_images_share_the_error_of_the_camera():
    """Their residuals hold it, and its covariance says how much: the ratio is one on average."""
    values = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        stars, estimate = scene(rng, frames=12, stars=8)
        others, own = scene(rng, frames=12, stars=8)
        off = (estimate.intrinsics - own.intrinsics) / INTRINSICS_SCALE
        held = others._replace(z=others.z - others.by_camera @ off)
        test = next(each for each in judged(stars, estimate, heldout=held).statistics
                    if each.name == residual_tests.HELD_OUT)
        assert test.passed
        values.append(test.value)
    freedom = 12 * (2 * 8 - 3)
    assert np.mean(values) == pytest.approx(1.0, abs=4.0 * np.sqrt(4.0 / freedom / 40))
    far = held._replace(z=held.z * 2.0)
    assert residual_tests.HELD_OUT in failed(judged(stars, estimate, heldout=far))


def test_too_few_stars_are_not_judged():
    found = judged(*scene(np.random.default_rng(6), frames=2, stars=8))
    assert not found.statistics and found.why.startswith('19 numbers are left')
    stars, estimate = scene(np.random.default_rng(6), frames=2, stars=8)
    none = stars._replace(**{name: part[:0] for name, part in stars._asdict().items()
                             if name != 'rejected'})
    assert judged(none, estimate).why.startswith('0 numbers')


def test_sample_is_even_and_bounded():
    sample, most = FrameSample(8), 0
    stamps = np.arange(1000)
    rng, at = np.random.default_rng(1), 0
    while at < 1000:
        batch = stamps[at:at + rng.integers(0, 40)]
        at += len(batch)
        sample.add(Frames(batch, np.zeros(len(batch) + 1, np.int64), np.empty((0, 2)),
                          np.empty(0), np.empty(0), np.empty(0, np.int64)))
        most = max(most, len(sample.frames))
    kept = sample.frames.stamp_ns
    assert most <= 8 and len(kept) >= 4
    assert kept[0] == 0 and len(np.unique(np.diff(kept))) == 1 and kept[-1] > 850


RECORDING = TAN2018.replace({'simulation.duration_s': 60.0})


@pytest.fixture(scope='module')
def recording():
    tracker, gyro = sensors.star_tracker(RECORDING), sensors.gyro(RECORDING)
    return tracker.next(tracker.count), gyro.next(gyro.count)


def verdict(frames, gyro, **parameters):
    method = calibration.start(RECORDING.replace({
        f'{group}.{name}': value for group, values in parameters.items()
        for name, value in values.items()}))
    method.add_gyro(gyro)
    method.add_frames(frames)
    estimate = method.estimate()
    assert estimate is not None
    return method.judge(estimate)


@pytest.mark.parametrize('method', calibration.names())
def test_every_method_is_judged_by_the_same_tests(method, recording):
    frames, gyro = recording
    identified = {'method': method, 'interstar_equations': 'TCOC'}
    right = verdict(frames, gyro, intrinsics=identified)
    assert right.word == 'not yet' and 'turned about the line of sight' in right.advice
    assert {*PATTERNS, residual_tests.AGREEMENT} <= {
        each.name for each in right.consistency.statistics}
    assert right.as_dict()['tolerance']['f_mm'] == 2e-4
    phase = 0.05 * np.sin(2.0 * np.pi * frames.uv_raster)
    wrong = verdict(replace(frames, uv_raster=frames.uv_raster + phase), gyro,
                    intrinsics=identified)
    assert wrong.word == 'inconsistent' and 'in a pixel' in wrong.advice
    assert residual_tests.PHASE in wrong.summary


def test_unidentified_spots_are_judged_by_what_the_method_leaves(recording):
    frames, gyro = recording
    unknown = replace(frames, catalog_id=np.zeros_like(frames.catalog_id))
    bundle = verdict(unknown, gyro, intrinsics={'method': 'bundle'})
    assert [each.name for each in bundle.consistency.statistics] == [
        residual_tests.LEVEL, residual_tests.REJECTIONS]
    assert bundle.consistency.statistics[0].value == pytest.approx(1.0, abs=0.1)
    noisy = replace(unknown, sigma=0.5 * np.where(unknown.sigma > 0.0, unknown.sigma, 0.05))
    assert verdict(noisy, gyro, intrinsics={'method': 'bundle'}).word == 'inconsistent'


def test_frames_of_few_stars_are_passed_over(recording):
    """Of four stars the gate takes good ones: their residuals are small where no attitude errs."""
    frames, gyro = recording
    number = np.arange(len(frames.catalog_id)) - frames.first[:-1][frames.frame_index]
    few = replace(frames, catalog_id=np.where(number < 4, frames.catalog_id, 0))
    judged_ = verdict(few, gyro, intrinsics={'method': 'angular_distance'})
    assert judged_.word == 'not yet' and judged_.consistency.why == camera_verdict.NO_FRAME
    six = replace(frames, catalog_id=np.where(number < 6, frames.catalog_id, 0))
    judged_ = verdict(six, gyro, intrinsics={'method': 'angular_distance'})
    assert judged_.consistency.statistics and not judged_.consistency.failed


def test_interstar_angles_of_unidentified_spots_are_never_called_consistent():
    scenario = RECORDING.replace({'intrinsics.method': 'interstar'})
    estimate = CameraEstimate(INTRINSICS, np.zeros((7, 7)), 1, 1)
    found = camera_verdict.of_frames(Frames.empty(), estimate, scenario)
    said = camera_verdict.judge(found, estimate, scenario)
    assert said.word == 'not yet' and 'not identified' in said.advice


def test_a_camera_that_may_walk_is_freed_in_each_run_of_frames(recording):
    frames, gyro = recording
    grows = 1.0 + 3e-4 * frames.frame_index[:, None] / len(frames)
    centre = DETECTOR.centre_raster
    walking = replace(frames, uv_raster=centre + (frames.uv_raster - centre) * grows)
    still = verdict(walking, gyro, intrinsics={'method': 'bundle'})
    assert residual_tests.TIME in failed(still.consistency)
    walks = verdict(walking, gyro, intrinsics={'method': 'bundle'},
                    estimator={'process_noise.focal_length_mm_sqrt_h': 0.1})
    assert walks.word == 'not yet'
    assert residual_tests.TIME not in {each.name for each in walks.consistency.statistics}


def test_a_long_recording_is_judged_by_some_of_its_stars(recording):
    frames, gyro = recording
    method = calibration.start(RECORDING.replace({'intrinsics.method': 'bundle'}))
    method.add_gyro(GyroSamples.empty())
    method.add_frames(frames)
    few = method.judge(method.estimate(), most_stars=500)
    assert 300 < few.consistency.statistics[-1].samples <= 500
