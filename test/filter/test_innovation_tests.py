# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The innovations of right models pass, those of wrong ones are named, the identities hold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, norm

from instruments import TAN2018
from starcal_ros.core import kalman, rotation
from starcal_ros.core.statistic import ALARM
from starcal_ros.filter import verdict
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.innovation_tests import (HISTORY, WINDOW, FrameInnovation, InnovationTests,
                                                 _deviate, gated_nis)
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.results.result import result, word
from starcal_ros.simulation import sensors

RUN = {'simulation.duration_s': 900.0, 'motion.dwell_s': 5.0}
DEG_PER_HOUR = np.pi / 180.0 / 3600.0


def calibrated(settings=None, spoil=None, seed=1):
    """Return the calibrator after a quarter of an hour of simulated or spoilt messages."""
    scenario = TAN2018.replace({**RUN, 'simulation.seed': seed, **(settings or {})})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    if spoil:
        samples, frames = spoil(samples, frames)
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(samples)
    calibrator.add_frames(frames)
    for _ in calibrator.process():
        pass
    return calibrator


def failed(calibrator):
    return {each.name for each in calibrator.consistency.statistics() if not each.passed}


# The identities


def test_explained_is_the_share_that_a_free_turn_takes_out_of_the_sum_of_squares():
    """Against S written out: z'S^-1 z less its minimum over z - A t, and the t that does it."""
    rng = np.random.default_rng(1)
    root, H = rng.normal(size=(5, 5)), rng.normal(size=(9, 2, 5))
    z, A, sigma = rng.normal(size=(9, 2)), rng.normal(size=(9, 2, 3)), rng.uniform(0.5, 2.0, 9)
    use = rng.random(9) < 0.7
    innovation = kalman.innovate(root, H, z, sigma)
    N, v = kalman.explained(innovation, A / sigma[:, None, None], use)
    rows = np.repeat(use, 2)
    H, z, A = H.reshape(18, 5)[rows], z.ravel()[rows], A.reshape(18, 3)[rows]
    S = H @ root @ root.T @ H.T + np.diag(np.repeat(sigma, 2)[rows]**2)
    np.testing.assert_allclose(N, A.T @ np.linalg.solve(S, A), rtol=1e-9)
    t = np.linalg.solve(N, v)
    rest = (z - A @ t) @ np.linalg.solve(S, z - A @ t)
    assert z @ np.linalg.solve(S, z) - rest == pytest.approx(v @ t, rel=1e-9)


def test_explained_takes_leading_batch_axes():
    rng = np.random.default_rng(2)
    root, H, z = rng.normal(size=(4, 5, 5)), rng.normal(size=(4, 9, 2, 5)), rng.normal(
        size=(4, 9, 2))
    A, use = rng.normal(size=(4, 9, 2, 3)), rng.random((4, 9)) < 0.7
    N, v = kalman.explained(kalman.innovate(root, H, z, np.ones((4, 9))), A, use)
    for k in range(4):
        one = kalman.explained(kalman.innovate(root[k], H[k], z[k], np.ones(9)), A[k], use[k])
        np.testing.assert_allclose(N[k], one[0], rtol=1e-9)
        np.testing.assert_allclose(v[k], one[1], rtol=1e-9)


@pytest.mark.parametrize('freedom, value', [(360, 300.0), (360, 470.0), (5600, 6200.0)])
def test_deviate_is_as_probable_as_the_chi_square(freedom, value):
    """Wilson and Hilferty's deviate is good to 0.01 at hundreds of degrees of freedom."""
    exact = norm.isf(chi2.sf(value, freedom))
    assert _deviate(value, freedom) == pytest.approx(exact, abs=0.02)


def noise(n, rng, scale=1.0, used=25):
    """Return frames of a right model, or of one whose turns are larger by a factor."""
    for _ in range(n):
        e = scale * rng.normal(size=3)
        rest = rng.chisquare(2 * used - 3)
        yield FrameInnovation(
            e, 1e5 * rotation.exp(rng.normal(size=3)), float(e @ e + rest), used, 0.5,
            0.01 * rng.normal(size=3), np.arange(used), rng.normal(size=(used, 2)))


def test_frames_of_a_right_model_pass_in_all_of_300_runs():
    for seed in range(300):
        tests, rng = InnovationTests(1.0), np.random.default_rng(seed)
        for k, frame in enumerate(noise(3 * WINDOW, rng)):
            tests.add(k, frame)
        assert all(each.passed for each in tests.statistics()), seed


def test_bands_hold_what_they_promise():
    """Of 4000 short runs the NIS leaves a band of 1e-5 never, and is uniform in probability."""
    values = []
    for seed in range(400):
        tests, rng = InnovationTests(1.0), np.random.default_rng(1000 + seed)
        for k, frame in enumerate(noise(40, rng)):
            tests.add(k, frame)
        values.append([each.value for each in tests.statistics()])
    turn, rest, mean, lag, along, _ = np.array(values).T
    assert np.mean(turn) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 120 / 400))
    assert np.mean(rest) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 1880 / 400))
    assert np.mean(mean**2) == pytest.approx(3.0, abs=4 * np.sqrt(6 / 400))
    assert np.std(lag) == pytest.approx(1.0, abs=0.15) and np.std(along) == pytest.approx(
        1.0, abs=0.15)


def test_a_failing_statistic_says_since_when():
    tests, rng = InnovationTests(1.0), np.random.default_rng(3)
    frames = [*noise(5 * WINDOW, rng), *noise(5 * WINDOW, rng, 2.0)]
    for k, frame in enumerate(frames):
        tests.add(1_782_993_600 * 10**9 + k * 5 * 10**8, frame)
    turns = tests.statistics()[0]
    assert not turns.passed and 1.0 < turns.high < turns.value < 4.0
    since = (turns.since_ns - 1_782_993_600 * 10**9) / 5e8
    assert 5 * WINDOW < since <= 6 * WINDOW
    assert ', since 2026-07-02T12:0' in turns.sentence


def test_the_history_of_the_statistics_is_kept_and_bounded(monkeypatch):
    monkeypatch.setattr('starcal_ros.filter.innovation_tests.WINDOW', 2)
    tests, rng = InnovationTests(1.0), np.random.default_rng(8)
    for k, frame in enumerate(noise(5 * HISTORY, rng, used=4)):
        tests.add(k, frame)
    stamps = [stamp_ns for stamp_ns, _ in tests.history]
    assert HISTORY // 2 <= len(stamps) < HISTORY and stamps[-1] > 4.9 * HISTORY
    assert len(set(np.diff(stamps))) == 1
    assert tests.history[-1][1][0].name == 'NIS of the turns'


def test_a_noise_that_is_off_by_a_tenth_passes_and_one_by_a_fifth_does_not():
    for scale, passed in ((0.93, True), (1.07, True), (0.8, False), (1.2, False)):
        tests, rng = InnovationTests(1.0), np.random.default_rng(5)
        for k, frame in enumerate(noise(20 * WINDOW, rng)):
            tests.add(k, frame._replace(e=scale * frame.e, nis=scale**2 * frame.nis))
        assert all(each.passed for each in tests.statistics()) is passed, scale


def test_one_star_of_many_that_is_displaced_is_found_and_by_how_much():
    tests, rng = InnovationTests(1.0), np.random.default_rng(6)
    for k, frame in enumerate(noise(100, rng)):
        frame.normal[7, 1] += 1.0
        tests.add(k, frame)
    star = tests.statistics()[-1]
    assert star.name == 'displacement of the worst star' and not star.passed
    assert star.value == pytest.approx(10.0, abs=4.0) and star.samples == 25


def test_frames_that_are_not_certain_or_too_small_are_passed_over():
    tests, (frame,) = InnovationTests(1.0), noise(1, np.random.default_rng(4))
    for k in range(100):
        tests.add(k, frame._replace(spread=5.0))
        tests.add(k, frame._replace(used=2))
        tests.add(k, frame._replace(nis=np.inf))
        tests.add(k, frame._replace(rate=np.full(3, np.nan)))
    assert tests.statistics() == () and tests.variance_factors == (1.0, 1.0)
    assert 0.0 < ALARM < 1e-3 and gated_nis(1.0) == 1.0


def test_a_frame_of_one_star_three_times_is_passed_over():
    """It tells no roll: N of (C.1) has no root."""
    scenario = TAN2018.replace({**RUN, 'simulation.duration_s': 20.0})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    star = np.repeat(frames.first[20], 3)
    one = replace(frames[20:21], first=np.array([0, 3]), uv_raster=frames.uv_raster[star],
                  sigma=frames.sigma[star], magnitude=frames.magnitude[star],
                  catalog_id=frames.catalog_id[star])
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(samples)
    calibrator.add_frames(Frames.concatenate((frames[:20], one, frames[21:])))
    results = list(calibrator.process())
    assert len(results) == len(frames) and results[20].accepted.sum() == 3
    assert calibrator.consistency.statistics()[0].samples == len(frames) - 2
    assert failed(calibrator) == set()


# Models, right and wrong


@pytest.mark.parametrize('settings', [
    {}, {'truth.star_tracker.misidentified_fraction': 0.02},
    {'truth.star_tracker.hot_pixels_per_frame': 5}, {'star_tracker.limiting_magnitude': 4.5}],
    ids=['clean', 'two per cent wrong stars', 'hot pixels', 'few stars'])
def test_what_the_gate_is_for_contradicts_no_model(settings):
    for seed in (1, 2):
        assert failed(calibrated(settings, seed=seed)) == set()


def late(ms):
    return lambda gyro, frames: (gyro, replace(
        frames, stamp_ns=frames.stamp_ns + round(ms * 1e6)))


def bias_jump(deg_h):
    def spoil(gyro, frames):
        rate = gyro.rate.copy()
        rate[len(rate) // 2:, 0] += deg_h * DEG_PER_HOUR
        return GyroSamples(gyro.stamp_ns, rate), frames
    return spoil


def fast_clock(ppm):
    def spoil(gyro, frames):
        since = gyro.stamp_ns - gyro.stamp_ns[0]
        return GyroSamples(gyro.stamp_ns[0] + (since * (1.0 - 1e-6 * ppm)).astype(np.int64),
                           gyro.rate), frames
    return spoil


def longer(um):
    def spoil(gyro, frames):
        uv, half = frames.uv_raster.copy(), frames.first[len(frames) // 2]
        uv[half:] = 511.5 + (uv[half:] - 511.5) * (1.0 + 1e-3 * um / 25.6)
        return gyro, replace(frames, uv_raster=uv)
    return spoil


def displaced(gyro, frames):
    """Move three stars by 8 arcsec, 0.15 px."""
    uv = frames.uv_raster.copy()
    uv[np.isin(frames.catalog_id, np.unique(frames.catalog_id)[:3])] += 0.15
    return gyro, replace(frames, uv_raster=uv)


def boot_time(gyro, frames):
    back = gyro.stamp_ns[0] - 10**10
    return (GyroSamples(gyro.stamp_ns - back, gyro.rate),
            replace(frames, stamp_ns=frames.stamp_ns - back))


@pytest.mark.parametrize('settings, spoil, test', [
    ({}, late(5.0), 'correlation of turns from frame to frame'),
    ({}, late(2.0), 'turns along the rate'),
    ({}, fast_clock(10.0), 'NIS of the turns'),
    ({}, boot_time, 'NIS of the turns'),
    ({}, displaced, 'displacement of the worst star'),
    ({'truth.gyro.arw_deg_sqrt_h': 0.003}, None, 'correlation of turns from frame to frame'),
    ({'truth.gyro.arw_deg_sqrt_h': 0.01}, None, 'NIS of the turns'),
    ({}, bias_jump(1.0), 'mean of the turns'),
    ({}, bias_jump(0.1), 'mean of the turns'),
    ({}, longer(5.0), 'NIS of the rest'),
    ({'truth.gyro.scale_factor_ppm': (300.0,) * 3}, None, 'turns along the rate'),
    ({'truth.star_tracker.centroid_sigma_px': 0.15}, None, 'NIS of the rest'),
    ({'truth.star_tracker.centroid_sigma_px': 0.03}, None, 'NIS of the rest'),
    ({'truth.star_tracker.smear': True}, None, 'NIS of the rest'),
], ids=['5 ms late', '2 ms late', 'clock 10 ppm', 'boot time', 'three stars', 'walk x 3',
        'walk x 10', 'bias jump 1', 'bias jump 0.1', 'longer by 5 um', 'scale 300 ppm',
        'noise x 3', 'noise x 0.6', 'smear'])
def test_a_wrong_model_is_named_and_can_not_have_converged(settings, spoil, test):
    calibrator = calibrated(settings, spoil)
    assert test in failed(calibrator)
    # Where the stars scatter so much that the gate rejects most of a frame, it is lost as well.
    assert word(calibrator) in ('inconsistent', 'lost')
    outcome = result(calibrator, {})
    assert outcome['verdict'] == word(calibrator) and outcome['converged'] is False
    assert {each['name'] for each in outcome['consistency'] if not each['passed']} == failed(
        calibrator)
    judged = verdict.judge(calibrator.filter, calibrator.belief, calibrator.tracking,
                           calibrator.consistency.statistics())
    assert judged.word == word(calibrator) and not judged.converged
    assert judged.summary.startswith(('inconsistent: ', 'lost: '))
