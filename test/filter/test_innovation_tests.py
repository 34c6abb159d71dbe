# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The innovations of right models pass, those of wrong ones are named, the identities hold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, norm

from instruments import TAN2018, calibrated, failed
from starcal_ros.core import kalman, rotation
from starcal_ros.filter.allowances import WINDOW
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.frame_innovation import CELLS, FrameInnovation
from starcal_ros.filter.innovation_tests import InnovationTests, _deviate
from starcal_ros.measurements.samples import Frames
from starcal_ros.simulation import sensors

RUN = {'simulation.duration_s': 600.0, 'motion.dwell_s': 5.0}


# The identities


def test_explained_is_the_share_that_a_free_turn_takes_out_of_the_sum_of_squares():
    """Against S written out: z'S^-1 z less its minimum over z - A t, and the t that does it."""
    rng = np.random.default_rng(1)
    root, H = rng.normal(size=(5, 5)), rng.normal(size=(9, 2, 5))
    z, A, sigma = rng.normal(size=(9, 2)), rng.normal(size=(9, 2, 3)), rng.uniform(0.5, 2.0, 9)
    use = rng.random(9) < 0.7
    innovation = kalman.innovate(root, H, z, sigma)
    said = kalman.evidence(innovation, H / sigma[:, None, None], use, root)
    rows = np.repeat(use, 2)
    N, v = said.explained((A / sigma[:, None, None]).reshape(18, 3) * rows[:, None])
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
    use = rng.random((4, 9)) < 0.7
    A = rng.normal(size=(4, 18, 3)) * np.repeat(use, 2, axis=-1)[..., None]
    N, v = kalman.evidence(kalman.innovate(root, H, z, np.ones((4, 9))), H, use,
                           root).explained(A)
    for k in range(4):
        one = kalman.evidence(kalman.innovate(root[k], H[k], z[k], np.ones(9)), H[k], use[k],
                              root[k]).explained(A[k])
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
            e, 1e5 * rotation.exp(rng.normal(size=3)), float(e @ e + rest), used,
            0.01 * rng.normal(size=3), np.arange(used), rng.normal(size=(used, 2)),
            np.arange(used) % CELLS**2, np.linspace(1.0, 8.0, used), 0.0)


def test_frames_of_a_right_model_pass_in_all_of_100_runs():
    for seed in range(100):
        tests, rng = InnovationTests(1.0), np.random.default_rng(seed)
        for frame in noise(3 * WINDOW, rng):
            tests.add(frame)
        assert all(each.passed for each in tests.statistics()), seed


def test_bands_hold_what_they_promise():
    """Of 4000 short runs the NIS leaves a band of 1e-5 never, and is uniform in probability."""
    values = []
    for seed in range(400):
        tests, rng = InnovationTests(1.0), np.random.default_rng(1000 + seed)
        for frame in noise(40, rng):
            tests.add(frame)
        values.append([each.value for each in tests.statistics()[:5]])
    turn, rest, mean, lag, along = np.array(values).T
    assert np.mean(turn) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 120 / 400))
    assert np.mean(rest) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 1880 / 400))
    assert np.mean(mean**2) == pytest.approx(3.0, abs=4 * np.sqrt(6 / 400))
    assert np.std(lag) == pytest.approx(1.0, abs=0.15) and np.std(along) == pytest.approx(
        1.0, abs=0.15)


def test_a_noise_that_is_off_by_a_tenth_passes_and_one_by_a_fifth_does_not():
    for scale, passed in ((0.93, True), (1.07, True), (0.8, False), (1.2, False)):
        tests, rng = InnovationTests(1.0), np.random.default_rng(5)
        for frame in noise(20 * WINDOW, rng):
            tests.add(frame._replace(e=scale * frame.e, nis=scale**2 * frame.nis))
        assert all(each.passed for each in tests.statistics()) is passed, scale


def test_one_star_of_many_that_is_displaced_is_found_and_by_how_much():
    tests, rng = InnovationTests(1.0), np.random.default_rng(6)
    for frame in noise(100, rng):
        frame.normal[7, 1] += 1.0
        tests.add(frame)
    star, = (each for each in tests.statistics() if each.name == 'displacement of the worst star')
    assert not star.passed
    assert star.value == pytest.approx(8.0, abs=4.0) and star.samples == 25


def test_a_frame_of_one_star_three_times_is_passed_over():
    """It tells no roll: N of (C.1) has no root."""
    scenario = TAN2018.replace({**RUN, 'simulation.duration_s': 20.0})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    star = np.repeat(frames.first[30], 3)
    one = replace(frames[30:31], first=np.array([0, 3]), uv_raster=frames.uv_raster[star],
                  sigma=frames.sigma[star], magnitude=frames.magnitude[star],
                  catalog_id=frames.catalog_id[star])
    counted = []
    for given in (frames, Frames.concatenate((frames[:30], one, frames[31:]))):
        calibrator = Calibrator(scenario)
        calibrator.add_gyro(samples)
        calibrator.add_frames(given)
        results = list(calibrator.process())
        assert len(results) == len(frames)
        counted.append(calibrator.consistency.statistics()[0].samples)
        assert failed(calibrator) == set()
    assert results[30].accepted.sum() == 3
    assert counted[1] == counted[0] - 1


@pytest.mark.parametrize('settings', [
    {'truth.star_tracker.misidentified_fraction': 0.02},
    {'truth.star_tracker.hot_pixels_per_frame': 5}, {'star_tracker.limiting_magnitude': 4.5}],
    ids=['two per cent wrong stars', 'hot pixels', 'few stars'])
def test_what_the_gate_is_for_contradicts_no_model(settings):
    calibrator = calibrated(TAN2018.replace({**RUN, **settings}))
    assert failed(calibrator) == set() and calibrator.consistency.changes == []
