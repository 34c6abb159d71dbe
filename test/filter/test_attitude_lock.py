# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""An attitude that is lost is found again, and costs nothing of the calibration."""

import numpy as np
import pytest
from scipy.stats import chi2

from starcal_ros.core import rotation
from starcal_ros.core.units import DEG
from starcal_ros.filter.belief import Nominal
from starcal_ros.filter.states import CALIBRATED
from starcal_ros.measurements.samples import Frames
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.sky import catalog
from streams import SCENARIO, START_NS, Simulated, altered, assert_right, calibrated, without


@pytest.fixture(scope='module')
def turned():
    """The same run, the body turned by 5 deg in i."""
    turn = rotation.exp(5.0 * DEG * np.array([0.6, 0.0, 0.8]))
    return Simulated(SCENARIO.replace({
        'motion.initial_quaternion_xyzw': tuple(rotation.to_quaternion(turn).tolist())}))


def test_attitude_that_jumps_is_found_again_and_said(run, turned):
    """From 45 s on the stars are those of a body turned by 5 deg; the gyro felt nothing."""
    calibrator, results = calibrated(run.gyro, Frames.concatenate((run.frames[:90],
                                                                   turned.frames[90:])))
    assert calibrator.counts.acquisitions == 2
    # rejected five times, then found
    rejected = [not result.accepted.any() for result in results]
    assert sum(rejected) in (4, 5) and all(rejected[90:94])
    assert_right(run, results[89])
    for result in results[96::10]:
        assert_right(turned, result)
    notices = calibrator.take_notices()
    assert any('found again' in text for text in notices)
    assert any('sought afresh' in text for text in notices)
    assert calibrator.tracking


def test_lost_attitude_costs_nothing_of_the_calibration(run, turned):
    calibrator, results = calibrated(run.gyro, Frames.concatenate((run.frames[:90],
                                                                   turned.frames[90:])))
    before, after = results[89].belief, results[100].belief
    # EPSILON and PSI are told from the motion, of which the jump's side is lost; not the camera
    assert (after.sigma[CALIBRATED] <= before.sigma[CALIBRATED] * (1 + 1e-9)).all()


@pytest.mark.parametrize('seed', range(3))
def test_stars_with_wrong_numbers_are_refused_and_the_rest_is_used(run, seed):
    number = run.frames.catalog_id.copy()
    rng = np.random.default_rng(seed)
    rows = rng.permutation(len(number))[:len(number) * 3 // 10]
    number[rows] = rng.choice(catalog.load(6.0).hip, len(rows))
    calibrator, results = calibrated(run.gyro, altered(run.frames, catalog_id=number))
    assert calibrator.counts.acquisitions == 1
    assert abs(calibrator.counts.rejected_stars - len(rows)) <= 5    # good ones: one in 10 000
    assert_right(run, results[-1])


@pytest.mark.parametrize('part', [0.1, 0.3])
def test_wrong_stars_and_silences_together_leave_the_sigmas_true(part):
    """20 s without gyro, 10 s without stars: the NEES of 16 states, 4 runs, by chance 1 in 1e4.

    A third of the stars has its neighbour's number or a place that is off by 0.5 to 50 px.
    """
    nees = []
    for seed in range(4):
        run = Simulated(SCENARIO.replace({
            'simulation.seed': seed, 'truth.star_tracker.misidentified_fraction': 0.5 * part}))
        rng, uv = np.random.default_rng(seed), run.frames.uv_raster.copy()
        wrong = rng.random(len(uv)) < 0.5 * part
        uv[wrong] += 10.0**rng.uniform(-0.3, 1.7, (wrong.sum(), 1)) * rng.normal(
            size=(wrong.sum(), 2))
        t = (run.frames.stamp_ns - START_NS) * 1e-9
        calibrator, results = calibrated(
            without(run.gyro, (20.0, 40.0)),
            altered(run.frames, uv_raster=uv).take((t < 60.0) | (t > 70.0)))
        truth = run.truth
        nees.append(results[-1].belief.nees(Nominal(
            run.C_gi(results[-1].stamp_ns)[0], truth.bias, truth.C_sg, truth.intrinsics)))
    assert chi2.ppf(5e-5, 64) < np.sum(nees) < chi2.isf(5e-5, 64)


@pytest.mark.parametrize('stated, nominal, believed', [
    (2e-4, 0.05, 0.005), (0.02, 0.05, 0.02), (2e-4, 0.002, 0.002), (0.0, 0.05, 0.05)])
def test_sigma_that_no_tracker_reaches_is_not_believed(run, stated, nominal, believed):
    """But where the scenario states as little."""
    frames = altered(run.frames[:1], sigma=np.full(run.frames.star_counts[0], stated))
    directions = StarDirections(SCENARIO.replace({'star_tracker.centroid_sigma_px': nominal}))
    np.testing.assert_array_equal(directions.of(frames).sigma, believed)


def test_frames_without_any_star_of_the_catalogue_never_begin_a_track(run):
    number = np.full(len(run.frames.catalog_id), 0)
    calibrator, results = calibrated(run.gyro, altered(run.frames, catalog_id=number))
    assert results == [] and calibrator.belief is None and not calibrator.tracking
    assert (calibrator.counts.frames, calibrator.counts.empty_frames) == (180, 180)
    assert any('no attitude' in text and '0 of' in text for text in calibrator.take_notices())
