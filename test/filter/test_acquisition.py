# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The attitude from one frame: accuracy, wrong star numbers, too few stars."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import INTRINSICS, PITCH_MM, TAN2018
from starcal_ros.config.models import observer
from starcal_ros.core import camera, rotation
from starcal_ros.core.consensus import consensus
from starcal_ros.core.units import ARCSEC, DEG
from starcal_ros.filter import acquisition
from starcal_ros.filter.acquisition import (MIN_STARS, WIDE, AcquisitionError, acquire, agreed,
                                            is_torn, turned)
from starcal_ros.filter.belief import Nominal
from starcal_ros.filter.error_state import SIGMA_ACQUIRED, Filter
from starcal_ros.filter.states import CALIBRATED, LENS, SCALE, THETA
from starcal_ros.measurements.samples import Stars
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places

# Truth against nominal: 374 arcsec of mounting, 11 px, 0.1 mm, and the distortion of T18 Table 1.
FILTER = Filter(TAN2018)
PLACES = range(12)


class Look:
    """One frame somewhere in the sky, and the truth behind it."""

    def __init__(self, seed, scenario=TAN2018):
        q_ig = np.random.default_rng([7, seed]).normal(size=4)
        scenario = scenario.replace({
            'simulation.seed': seed, 'simulation.duration_s': 1.0,
            'motion.initial_quaternion_xyzw': tuple((q_ig / np.linalg.norm(q_ig)).tolist())})
        truth = Truth.from_scenario(scenario)
        self.truth = Nominal(truth.motion.attitude(np.array([truth.motion.start_ns]))[0].T,
                             truth.bias, truth.C_sg, truth.intrinsics)
        self.frames = sensors.star_tracker(scenario).next(1)
        self.stars = self.stars_as(self.frames.catalog_id)

    def stars_as(self, numbers):
        """Return the frame's centroids under these star numbers."""
        stars = catalog.load_containing(numbers)
        u_i = apparent_places(stars, stars.rows(numbers), self.frames.stamp_ns,
                              [len(numbers)], observer(TAN2018.observer))
        return Stars(u_i, self.frames.uv_raster - FILTER.detector.centre_raster,
                     self.frames.sigma.copy())

    def with_wrong_numbers(self, part, far, seed):
        """Return the frame with a part of its numbers wrong, and which."""
        rng, numbers = np.random.default_rng(seed), self.frames.catalog_id.copy()
        n = len(numbers)
        wrong = np.zeros(n, dtype=bool)
        wrong[rng.permutation(n)[:round(part * n)]] = True
        if far:
            numbers[wrong] = rng.choice(catalog.load(6.0).hip, wrong.sum(), replace=False)
        else:                                   # the numbers of other stars in the frame
            numbers[wrong] = np.roll(numbers[wrong], 1)
        return self.stars_as(numbers), wrong


def first(stars, count):
    """Return only some stars of a frame."""
    return Stars(*(part[:count] for part in stars))


@pytest.mark.parametrize('place', PLACES)
def test_attitude_is_found_from_nominal_errors_of_300_arcsec_10_px_and_0_1_mm(place):
    """Within 4 sigma of what the frame leaves open: mostly the principal point."""
    look = Look(place)
    belief, stars = acquire(FILTER, None, look.stars)
    update = FILTER.update(belief, stars)
    theta = update.belief.estimate.minus(look.truth)[THETA]
    assert (np.abs(theta) < 4.0 * update.belief.tracker_sigma).all()
    assert (update.belief.tracker_sigma < 0.5 * DEG).all()  # 20 px are 0.29 deg: no mere prior
    assert np.isfinite(stars.sigma).all()                   # all stars are right, all are kept


@pytest.mark.parametrize('place', PLACES)
def test_frame_fits_where_it_was_linearised(place):
    """The residuals of a fit of 2 n centroids are chi-square, of at most 2 n - 3 degrees."""
    look = Look(place)
    update = FILTER.update(*acquire(FILTER, None, look.stars))
    n = len(look.stars.sigma)
    squares = np.sum((update.residual / 0.05)**2)
    # the fit takes up at least the attitude, at most the 3 + 7 states that one frame can see
    assert chi2.ppf(5e-5, 2 * n - 10) < squares < chi2.ppf(1 - 5e-5, 2 * n - 3)
    assert update.accepted.all()


@pytest.mark.parametrize('place', PLACES)
def test_fit_has_come_to_rest_where_it_ends(place):
    """Its last step is less than 0.01 SCALE, so one more is, from errors of thousands of SCALE."""
    belief, frame = acquire(FILTER, None, Look(place).stars)
    again = FILTER.update(belief, frame, gated=False).belief.estimate
    assert np.abs(again.minus(belief.nominal) / SCALE).max() < 0.01


@pytest.mark.parametrize('place', PLACES)
def test_known_camera_gives_the_attitude_to_the_noise_of_the_centroids(place):
    scenario = TAN2018.replace({
        'truth.camera.focal_length_mm': 25.5, 'truth.camera.principal_point_px': (0.0, 0.0),
        'truth.camera.distortion': (0.0, 0.0, 0.0, 0.0),
        **{f'estimator.initial_sigma.{name}': 1e-12 for name in (
            'principal_point_px', 'focal_length_mm', 'k1', 'k2', 'p1', 'p2')}})
    look, filter_ = Look(place, scenario), Filter(scenario)
    belief = filter_.update(*acquire(filter_, None, look.stars)).belief
    theta = belief.nominal.minus(look.truth)[THETA]
    # Across, a pixel is 52 arcsec: sigma d / f / sqrt(n), for rotations about x and y alone.
    across = 0.05 * PITCH_MM / 25.5 / np.sqrt(len(look.stars.sigma))
    np.testing.assert_allclose(belief.tracker_sigma[:2], across, rtol=0.3)  # less well with z
    assert (np.abs(theta) < 4.0 * belief.tracker_sigma).all()


@pytest.mark.parametrize('far', [True, False], ids=['anywhere', 'of the same frame'])
@pytest.mark.parametrize('place', PLACES)
def test_stars_with_wrong_numbers_are_left_out_and_the_attitude_is_right(place, far):
    look = Look(place)
    stars, wrong = look.with_wrong_numbers(0.3, far, place)
    belief, kept = acquire(FILTER, None, stars)
    np.testing.assert_array_equal(np.isinf(kept.sigma), wrong)
    right = Stars(*(part[~wrong] for part in look.stars))
    expected = FILTER.update(*acquire(FILTER, None, right)).belief
    found = FILTER.update(belief, kept).belief
    # The same stars, fitted from another start: a fit ends at a step of 0.01 SCALE, which moves
    # centroids by 4e-4 px, a thirtieth of sigma / sqrt(17).
    difference = np.linalg.solve(expected.root, found.nominal.minus(expected.nominal) / SCALE)
    np.testing.assert_allclose(difference, 0.0, atol=0.05)
    theta = found.nominal.minus(look.truth)[THETA]
    assert (np.abs(theta) < 4.0 * found.tracker_sigma).all()


@pytest.mark.slow
@pytest.mark.parametrize('part', [0.3, 0.5])
def test_mixed_up_numbers_never_give_a_wrong_attitude(part):
    """Any mixture in any field: the right attitude, or an AcquisitionError and no other."""
    wrong = []
    for place in range(150):
        look = Look(place)
        try:
            belief, kept = acquire(FILTER, None, look.with_wrong_numbers(part, False, place)[0])
        except AcquisitionError:
            continue
        belief = FILTER.update(belief, kept).belief
        theta = belief.nominal.minus(look.truth)[THETA]
        if (np.abs(theta) > 5.0 * belief.tracker_sigma).any():  # by chance: 450 * 6e-7
            wrong.append(place)
    assert not wrong


KNOWN = TAN2018.replace({f'estimator.initial_sigma.{name}': 1e-12 for name in (
    'focal_length_mm', 'k1', 'k2', 'p1', 'p2')})


@pytest.mark.parametrize('scenario', [TAN2018, KNOWN], ids=['nominal camera', 'known camera'])
def test_stars_may_disagree_by_what_the_camera_may_be_wrong_by(monkeypatch, scenario):
    """6 sigma of all but the principal point, where they do most, and 10 sigma of a centroid."""
    given, look, filter_ = [], Look(0), Filter(scenario)

    def watched(u_i, r_s, wrong):
        given.append(wrong)
        return consensus(u_i, r_s, wrong)

    monkeypatch.setattr(acquisition, 'consensus', watched)
    with suppress(AcquisitionError):                # the true camera is not the one that is known
        acquire(filter_, None, look.stars)
    lens, sigma = filter_.start.intrinsics, filter_.initial_sigma[LENS]
    r_s = camera.unproject(look.stars.uv, lens, PITCH_MM)
    # each moves a centroid in proportion, so its difference is exact
    moved = [camera.project(r_s, lens + sigma * one, PITCH_MM) - look.stars.uv
             for one in np.eye(7)[2:]]
    spread = np.sqrt(np.sum(np.square(moved), axis=(0, 2))).max()
    assert given == pytest.approx([(6.0 * spread + 10.0 * 0.05) * PITCH_MM / 25.5], rel=1e-6)


@pytest.mark.parametrize('place', PLACES)
def test_centroid_that_is_off_by_some_pixels_is_left_out(place):
    """Too little to be seen in the angles, while the camera may be wrong by as much."""
    look = Look(place)
    look.stars.uv[3] += (3.0, -4.0)                         # 100 sigma
    _, kept = acquire(FILTER, None, look.stars)
    assert np.flatnonzero(np.isinf(kept.sigma)).tolist() == [3]


@pytest.mark.parametrize('place', PLACES)
def test_centroids_that_are_off_together_do_not_pull_the_fit_to_them(place):
    """A fifth of the stars, at one edge: a plain fit takes most of it for a turn and the lens."""
    look = Look(place)
    u = look.stars.uv[:, 0]
    wrong = u > np.quantile(u, 0.8)
    look.stars.uv[wrong] += (3.0, 0.0)                      # 60 sigma
    _, kept = acquire(FILTER, None, look.stars)
    np.testing.assert_array_equal(np.isinf(kept.sigma), wrong)


def test_first_fix_knows_the_calibration_as_the_scenario_does_and_no_attitude():
    """The frame is not used up: only the values from which it is linearised are its own."""
    belief, _ = acquire(FILTER, None, Look(0).stars)
    np.testing.assert_allclose(belief.tracker_sigma, SIGMA_ACQUIRED, rtol=1e-12)
    np.testing.assert_allclose(SCALE * np.linalg.norm(belief.root, axis=1), FILTER.initial_sigma,
                               rtol=1e-12)
    np.testing.assert_allclose(belief.estimate.minus(FILTER.start)[CALIBRATED], 0.0, atol=1e-12)


def test_later_fix_keeps_the_calibration():
    look = Look(1)
    known = FILTER.update(*acquire(FILTER, None, look.stars)).belief
    elsewhere = Look(2)
    belief, _ = acquire(FILTER, known, elsewhere.stars)
    np.testing.assert_allclose(belief.estimate.minus(known.estimate)[CALIBRATED] / SCALE[3:], 0.0,
                               atol=1e-6)
    np.testing.assert_allclose(belief.covariance[3:, 3:], known.covariance[3:, 3:], rtol=1e-9)
    # the attitude of the other look: 1 deg is less than what Look(1) would be off by
    turn = rotation.log(belief.nominal.C_si @ elsewhere.truth.C_si.T)
    assert np.linalg.norm(turn) < 1.0 * DEG


@pytest.mark.parametrize('count', range(MIN_STARS))
def test_too_few_stars_are_named_with_what_is_needed(count):
    stars = first(Look(0).stars, count)
    text = rf'^[0-{count}] of {count} stars agree with the catalogue, 3 are needed'
    with pytest.raises(AcquisitionError, match=text):
        acquire(FILTER, None, stars)


@pytest.mark.parametrize('count, right, enough', [(8, 4, True), (8, 3, False), (9, 5, True),
                                                  (9, 4, False)])
def test_half_of_the_stars_must_agree(count, right, enough):
    look = Look(0)
    numbers = look.frames.catalog_id.copy()
    numbers[right:] = np.random.default_rng(6).choice(
        catalog.load(6.0).hip, len(numbers) - right, replace=False)
    stars = first(look.stars_as(numbers), count)
    if enough:
        assert np.isfinite(acquire(FILTER, None, stars)[1].sigma).sum() == right
    else:
        text = f'^{right} of {count} stars agree with the catalogue, {(count + 1) // 2} are needed'
        with pytest.raises(AcquisitionError, match=text):
            acquire(FILTER, None, stars)


def test_three_stars_are_enough():
    look = Look(0)
    belief, _ = acquire(FILTER, None, first(look.stars, MIN_STARS))
    # the prior of the camera: 20 px, 0.29 deg, three times
    assert np.linalg.norm(rotation.log(belief.nominal.C_si @ look.truth.C_si.T)) < 1.0 * DEG


def test_unusable_stars_are_not_counted_as_agreeing():
    stars = first(Look(0).stars, 6)
    stars.sigma[2:] = np.inf
    with pytest.raises(AcquisitionError, match='^2 of [26] stars agree'):
        acquire(FILTER, None, stars)


def test_all_numbers_wrong_give_no_attitude():
    look = Look(3)
    stars, wrong = look.with_wrong_numbers(1.0, True, 5)
    assert wrong.all()
    with pytest.raises(AcquisitionError, match=f' of {len(wrong)} stars agree'):
        acquire(FILTER, None, stars)


# Frames whose prediction is wide


def turned_by(look, sigma_deg, seed):
    """Return a calibrated belief whose attitude is off by about what it says."""
    filter_ = Filter(TAN2018)
    belief = filter_.begin(np.eye(3))
    root = 1e-3 * belief.root
    root[THETA, THETA] = np.eye(3) * sigma_deg * DEG / SCALE[0]
    theta = sigma_deg * DEG * np.random.default_rng(seed).normal(size=3)
    return replace(belief, root=root, nominal=look.truth.without(
        np.concatenate((theta, np.zeros(13)))))


@pytest.mark.parametrize('far', [True, False], ids=['anywhere', 'of the same frame'])
@pytest.mark.parametrize('place', PLACES)
def test_after_a_silence_wrong_stars_are_left_out(place, far):
    """The attitude is uncertain by 10 px: each star's own gate takes wrong ones, too."""
    look = Look(place)
    stars, wrong = look.with_wrong_numbers(0.4, far, place)
    stars.uv[np.flatnonzero(~wrong)[0]] += (1.5, -2.0)           # well inside its own gate
    wrong[np.flatnonzero(~wrong)[0]] = True
    belief = turned_by(look, 0.15, place)
    alone = FILTER.update(belief, stars)
    assert alone.spread > WIDE and (alone.accepted & wrong).any()
    at, kept = agreed(FILTER, belief, stars)
    np.testing.assert_array_equal(np.isinf(kept.sigma), wrong)
    update = FILTER.update(at, kept)
    np.testing.assert_array_equal(update.accepted, ~wrong)
    error = update.belief.nominal.minus(look.truth)[THETA]
    assert (np.abs(error) < 4.0 * update.belief.tracker_sigma).all()


def seen_after(look, arcsec, stars=None):
    """Return what agrees on a turn of the camera about x that a certain belief denies."""
    belief = turned_by(look, 1e-4, 1)
    moved = belief.nominal.without(np.array([arcsec * ARCSEC, *(0.0,) * 15]))
    belief = replace(belief, nominal=moved)
    stars = look.stars if stars is None else stars
    return turned(FILTER, belief, stars) if is_torn(stars, FILTER.update(belief, stars)) else None


@pytest.mark.parametrize('place', PLACES)
def test_stars_that_agree_on_a_turn_which_the_prediction_denies_are_kept(place):
    """Twenty arcsec are six sigma of a star, of a prediction that is good to 0.4 arcsec."""
    look = Look(place)
    for arcsec in (20.0, 60.0):
        assert np.isfinite(seen_after(look, arcsec).sigma).all()
    stars, wrong = look.with_wrong_numbers(0.2, True, place)
    kept = seen_after(look, 40.0, stars)
    np.testing.assert_array_equal(np.isinf(kept.sigma), wrong)


@pytest.mark.parametrize('place', PLACES)
def test_without_such_a_turn_the_gates_of_the_stars_are_right(place):
    look = Look(place)
    assert seen_after(look, 0.0) is None
    stars, _ = look.with_wrong_numbers(0.4, False, place)
    assert seen_after(look, 0.0, stars) is None
    assert seen_after(look, 3600.0) is None         # too large for one step: sought afresh


def test_a_frame_without_agreement_is_not_used():
    look = Look(2)
    belief = turned_by(look, 0.15, 2)
    at, kept = agreed(FILTER, belief, look.with_wrong_numbers(0.8, False, 1)[0])
    assert at is belief and np.isinf(kept.sigma).all()
    assert not FILTER.update(at, kept).accepted.any()


def test_thousands_of_stars_of_which_half_are_wrong_are_judged_in_few_passes(monkeypatch):
    rng, n, passes = np.random.default_rng(9), 4000, []
    true = rng.uniform(-500.0, 500.0, (n, 2))
    wrong = rng.random(n) < 0.48
    uv = true + 0.05 * rng.normal(size=(n, 2))
    uv[wrong] += 10.0**rng.uniform(0.0, 2.5, (wrong.sum(), 1)) * rng.normal(size=(wrong.sum(), 2))
    original = Filter.update
    monkeypatch.setattr(Filter, 'update', lambda *args, **options: (
        passes.append(1), original(*args, **options))[1])
    _, kept = acquire(FILTER, None, Stars(camera.unproject(true, INTRINSICS, PITCH_MM), uv,
                                          np.full(n, 0.05)))
    assert len(passes) < 100
    used = np.isfinite(kept.sigma)
    # of 1e-4 good ones; a wrong one may lie within 4 sigma of its place
    assert (used & ~wrong).sum() > 0.999 * (~wrong).sum() and (used & wrong).sum() < 0.01 * n
