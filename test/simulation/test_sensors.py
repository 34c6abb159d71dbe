# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The truth and the simulated sensors: motion, gyro, star tracker."""

from dataclasses import fields

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import TAN2018
from starcal_ros.config import models
from starcal_ros.config.scenario import Scenario, stamp_ns
from starcal_ros.core import camera, rotation
from starcal_ros.core.units import DEG, DEG_PER_HOUR
from starcal_ros.measurements.preintegration import preintegrate
from starcal_ros.simulation import sensors
from starcal_ros.simulation.motion import Motion
from starcal_ros.simulation.star_tracker import StarTrackerSimulator
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places
from starcal_ros.sky.catalog import Catalog

NOISELESS = {'gyro.arw_deg_sqrt_h': 0.0, 'star_tracker.centroid_sigma_px': 0.0}
UNBIASED = {'truth.gyro.bias_deg_h': (0.0, 0.0, 0.0)}
# T18 Table 2 at 0.5 deg/s and 0.5 deg/s^2: 30 s of rest, 60 s + 1 s for 30 deg.
STEP_S, CYCLE_S = 91.0, 546.0
ROUNDING = 2e-15


@pytest.fixture(scope='module')
def motion():
    return Motion.from_scenario(TAN2018)


@pytest.fixture(scope='module')
def truth():
    return Truth.from_scenario(TAN2018)


def at(motion, *seconds):
    """Return C_ig at times since the start."""
    return motion.attitude(motion.start_ns + np.rint(np.array(seconds) * 1e9).astype(np.int64))


def turns(C):
    """Return the angle between neighbouring attitudes [rad]."""
    return np.linalg.norm(rotation.log(np.swapaxes(C[:-1], -1, -2) @ C[1:]), axis=-1)


def one_turn(angle_deg, **more):
    """Return a motion of one rotation about y, again and again, at rest for 2 s before it."""
    return Motion.from_scenario(Scenario().replace(
        {'motion.axes': ('y',), 'motion.angles_deg': (angle_deg,), 'motion.dwell_s': 2.0, **more}))


def same(a, b):
    return all(np.array_equal(getattr(a, field.name), getattr(b, field.name))
               for field in fields(a))


# Motion

def test_attitude_depends_on_the_stamp_alone(motion):
    stamps = motion.start_ns + np.random.default_rng(1).integers(0, 10**13, 200)
    whole = motion.attitude(stamps)
    np.testing.assert_array_equal(motion.attitude(stamps[::-1])[::-1], whole)
    one_by_one = [motion.attitude(stamps[k:k + 1])[0] for k in range(200)]
    np.testing.assert_array_equal(one_by_one, whole)


def test_table_2_returns_to_its_start(motion):
    np.testing.assert_allclose(at(motion, CYCLE_S, 2 * CYCLE_S, 20 * CYCLE_S),
                               np.tile(at(motion, 0.0), (3, 1, 1)), atol=20 * ROUNDING)


def test_table_2_turns_by_30_degrees_about_the_gyro_axes_in_turn(motion):
    """Axes of the body, so each rotation stands to the right of those before."""
    x, y, z = rotation.exp(30.0 * DEG * np.eye(3))
    expected = at(motion, 0.0) @ [np.eye(3), x, x @ y, x @ y @ z, x @ y, x]
    np.testing.assert_allclose(at(motion, *STEP_S * np.arange(6)), expected, atol=ROUNDING)


def test_it_rests_in_the_dwell(motion):
    for step in range(6):
        dwell = at(motion, *(step * STEP_S + np.linspace(0.0, 30.0, 31)))
        np.testing.assert_allclose(dwell, np.tile(dwell[0], (31, 1, 1)), atol=ROUNDING)


def test_rate_reaches_the_slew_rate_and_never_exceeds_it(motion):
    """Neighbours 10 ms apart, over a whole cycle and into the next: so there is no jump either."""
    rate = turns(at(motion, *np.arange(0.0, CYCLE_S + 100.0, 0.01))) / 0.01
    # an angle is good to 1e-15, and t in float64 to 1e-13 s
    np.testing.assert_allclose(rate.max(), 0.5 * DEG, rtol=1e-9)


def test_angle_follows_the_trapezoid():
    """0.5 deg/s^2 up to 0.5 deg/s after 1 s, for 30 deg; 2 s of rest before it."""
    motion = one_turn(30.0)
    angle = rotation.log(at(motion, 2.5, 3.0, 10.0, 62.0, 62.5, 63.0))[:, 1]
    np.testing.assert_allclose(angle / DEG, [0.0625, 0.25, 3.75, 29.75, 29.9375, 30.0],
                               rtol=1e-12)


def test_a_short_rotation_is_a_triangle_that_does_not_reach_the_slew_rate():
    """0.1 deg at 0.5 deg/s^2: sqrt(0.2) s up, as long down, at most sqrt(0.05) deg/s."""
    motion = one_turn(-0.1)
    half = np.sqrt(0.2)
    angle = rotation.log(at(motion, 2.0, 2.0 + half / 2, 2.0 + half, 2.0 + 2 * half))[:, 1]
    # stamps are whole nanoseconds: 1e-9 s at 0.22 deg/s
    np.testing.assert_allclose(angle / DEG, [0.0, -0.0125, -0.05, -0.1], atol=3e-10)
    rate = turns(at(motion, *np.arange(0.0, 5.0, 0.001))) / 0.001
    assert 0.99 * np.sqrt(0.05) * DEG < rate.max() < np.sqrt(0.05) * DEG


def test_what_a_cycle_leaves_behind_adds_up():
    motion = one_turn(30.0, **{'motion.initial_quaternion_xyzw': (0.6, 0.0, 0.0, 0.8)})
    start, cycle = at(motion, 0.0)[0], 2.0 + 61.0
    for n in range(4):
        np.testing.assert_allclose(at(motion, n * cycle + 1.0)[0],
                                   start @ rotation.exp(n * 30.0 * DEG * np.eye(3)[1]),
                                   atol=ROUNDING)


def test_attitude_begins_with_the_initial_quaternion():
    """C_ig of (0, 0.6, 0, 0.8): cosine 0.28 and sine 0.96 about y, as fractions."""
    motion = one_turn(1.0, **{'motion.initial_quaternion_xyzw': (0.0, 0.6, 0.0, 0.8)})
    np.testing.assert_allclose(at(motion, 0.0)[0],
                               [[0.28, 0.0, 0.96], [0.0, 1.0, 0.0], [-0.96, 0.0, 0.28]],
                               atol=ROUNDING)


# Gyro

def gyro_of(**more):
    return sensors.gyro(TAN2018.replace({**NOISELESS, **more}))


def test_a_reading_is_stamped_at_the_end_of_its_interval():
    gyro = gyro_of(**{'simulation.duration_s': 2.0})
    samples = gyro.next(1000)
    assert gyro.count == len(samples) == 200
    start = stamp_ns('start', '2026-07-02T12:00:00')
    np.testing.assert_array_equal(samples.stamp_ns, start + 10**7 * np.arange(1, 201))


def test_a_rate_that_does_not_divide_a_second_does_not_drift():
    samples = gyro_of(**{'gyro.rate_hz': 128.5, 'simulation.duration_s': 1000.0}).next(128_500)
    start = stamp_ns('start', '2026-07-02T12:00:00')
    assert samples.stamp_ns[-1] - start == 1000 * 10**9
    assert np.ptp(np.diff(samples.stamp_ns)) <= 1


def test_a_noiseless_reading_is_the_mean_rate_and_the_bias():
    """At rest; in the 10 ms after it (mean a dt / 2); at the slew rate about x."""
    rate = gyro_of().next(4000).rate - 0.01 * DEG_PER_HOUR
    expected = np.zeros((3, 3))
    expected[1:, 0] = 0.5 * DEG * 0.01 / 2, 0.5 * DEG
    # a turn is good to 1e-15 rad, over 10 ms
    np.testing.assert_allclose(rate[[1500, 3000, 3500]], expected, atol=1e-12)


def test_noiseless_readings_integrate_to_the_true_attitude(truth):
    gyro = gyro_of(**UNBIASED)
    samples = gyro.next(120_000)
    start = truth.motion.start_ns
    cuts = start + np.arange(0, 1201, 100) * 10**9
    result = preintegrate(samples, cuts, np.zeros(3), 1e7)
    C_gi = truth.motion.attitude(cuts[:1])[0].T
    for stamp, Delta in zip(cuts[1:], result.Delta):
        C_gi = Delta @ C_gi
        error = rotation.log(C_gi @ truth.motion.attitude(np.array([stamp]))[0])
        assert np.linalg.norm(error) < 1e-9


def test_noise_has_the_variance_of_the_angular_random_walk():
    """N = 0.001 deg/sqrt(h) at 100 Hz: N^2 / dt, of readings at rest."""
    simulator = sensors.gyro(TAN2018)
    variance = (0.001 * np.pi / 180.0 / 60.0)**2 / 0.01
    np.testing.assert_allclose(simulator.rate_variance, variance, rtol=1e-14)
    noise = simulator.next(3000).rate - 0.01 * DEG_PER_HOUR
    low, high = chi2.ppf([0.0005, 0.9995], len(noise))
    sums = np.sum(noise**2, axis=0) / variance
    assert (low < sums).all() and (sums < high).all()


# Star tracker

def tracker_of(**more):
    return sensors.star_tracker(TAN2018.replace({**NOISELESS, **more}))


def test_a_frame_is_stamped_from_the_start_on():
    tracker = tracker_of(**{'simulation.duration_s': 10.0})
    frames = tracker.next(1000)
    assert tracker.count == len(frames) == 20
    start = stamp_ns('start', '2026-07-02T12:00:00')
    np.testing.assert_array_equal(frames.stamp_ns, start + 5 * 10**8 * np.arange(20))


def test_centroid_noise_has_its_sigma():
    quiet, noisy = tracker_of().next(200), sensors.star_tracker(TAN2018).next(200)
    np.testing.assert_array_equal(noisy.catalog_id, quiet.catalog_id)
    np.testing.assert_array_equal(noisy.sigma, 0.05)
    noise = (noisy.uv_raster - quiet.uv_raster) / 0.05
    low, high = chi2.ppf([0.0005, 0.9995], len(noise))
    assert (low < np.sum(noise**2, axis=0)).all() and (np.sum(noise**2, axis=0) < high).all()


def test_stars_lie_on_the_detector_to_the_outer_edge_of_its_pixels():
    uv = tracker_of().next(1200).uv_raster
    assert uv.min() >= -0.5 and uv.max() <= 1023.5
    assert uv.min() < 5.0 and uv.max() > 1018.0         # of 30,000 stars some lie near the edge


def test_stars_are_down_to_the_limiting_magnitude():
    frames = tracker_of(**{'star_tracker.limiting_magnitude': 5.0}).next(1200)
    assert 4.9 < frames.magnitude.max() <= 5.0


def all_stars_in_the_field(setting, truth, stamps):
    """Project every star of the catalogue; yields catalogue rows and uv_raster of each frame.

    Within 20 deg of the boresight only: far outside the field the distortion of T18 folds over.
    """
    stars = catalog.load(setting.star_tracker.limiting_magnitude)
    rows = np.arange(len(stars))
    for stamp in stamps.reshape(-1, 1):
        u_i = apparent_places(stars, rows, stamp, [len(stars)],
                              models.observer(setting.observer))
        r_s = u_i @ truth.attitude_si(stamp)[0].T
        near = r_s[:, 2] > np.cos(20.0 * DEG)
        uv = camera.project(r_s[near], truth.intrinsics, truth.detector.pitch_mm)
        inside = truth.detector.contains(uv)
        yield rows[near][inside], uv[inside] + truth.detector.centre_raster


@pytest.mark.parametrize('velocity', ['barycentre', 'geocentre', 'orbit'])
def test_a_frame_holds_all_stars_in_the_field_where_the_observer_sees_them(truth, velocity):
    setting = TAN2018.replace({**NOISELESS, 'observer.velocity': velocity,
                               'star_tracker.rate_hz': 0.02})
    frames = sensors.star_tracker(setting).next(8)
    stars = catalog.load(setting.star_tracker.limiting_magnitude)
    for k, (rows, uv) in enumerate(all_stars_in_the_field(setting, truth, frames.stamp_ns)):
        frame = frames[k:k + 1]
        np.testing.assert_array_equal(frame.catalog_id, stars.hip[rows])
        np.testing.assert_array_equal(frame.magnitude, stars.magnitude[rows])
        # sums of three products in another order: 1e-16 of directions, 4000 px/rad
        np.testing.assert_allclose(frame.uv_raster, uv, atol=1e-11)


def test_no_star_is_missed_in_a_corner_that_lies_far_from_the_boresight():
    """Some 200 stars a frame, and a principal point in the corner of the detector."""
    setting = TAN2018.replace({
        **NOISELESS, 'observer.velocity': 'barycentre', 'star_tracker.rate_hz': 0.05,
        'star_tracker.limiting_magnitude': 8.0, 'truth.camera.principal_point_px': (500.0, 450.0)})
    frames = sensors.star_tracker(setting).next(25)
    truth = Truth.from_scenario(setting)
    hip = catalog.load(8.0).hip
    found = [hip[rows] for rows, _ in all_stars_in_the_field(setting, truth, frames.stamp_ns)]
    assert len(frames.catalog_id) > 2000
    np.testing.assert_array_equal(frames.catalog_id, np.concatenate(found))


def pole(limiting_magnitude=6.2, **more):
    """Return the only frame of a sky with one star, of magnitude 1, at which the camera looks."""
    setting = Scenario().replace({
        'camera.width': 1000, 'camera.height': 601, 'observer.velocity': 'barycentre',
        'star_tracker.limiting_magnitude': limiting_magnitude, 'star_tracker.smear': False,
        **NOISELESS, **more})
    star = Catalog(np.array([7]), *np.array(
        [[0.0], [np.pi / 2], [0.0], [0.0], [0.0], [1.0], [0.0]]))
    return StarTrackerSimulator(setting, Truth.from_scenario(setting), star,
                                np.random.default_rng(1)).next(1)


# 49 deg to the corner without distortion, 65 deg with it; one to one as far as there is a sky.
BARREL = {'truth.camera.focal_length_mm': 4.0,
          'truth.camera.distortion': (-0.02, 2e-4, 1e-4, -1e-4)}


def random_sky(count):
    rng = np.random.default_rng(4)
    zero = np.zeros(count)
    return Catalog(np.arange(1, count + 1), rng.uniform(0.0, 2.0 * np.pi, count),
                   np.arcsin(rng.uniform(-1.0, 1.0, count)), *(zero,) * 5)


@pytest.fixture(scope='module')
def barrel():
    setting = TAN2018.replace({**BARREL, 'truth.star_tracker.centroid_sigma_px': 0.0,
                               'star_tracker.rate_hz': 0.02, 'observer.velocity': 'barycentre'})
    truth, stars = Truth.from_scenario(setting), random_sky(30_000)
    return setting, truth, stars, StarTrackerSimulator(
        setting, truth, stars, np.random.default_rng(1)).next(10)


def test_no_star_that_a_strong_barrel_draws_in_is_left_out(barrel):
    """Against all stars of the sky in front of the camera."""
    setting, truth, stars, frames = barrel
    C_si = truth.attitude_si(frames.stamp_ns)
    for k, stamp in enumerate(frames.stamp_ns):
        u_i = apparent_places(stars, np.arange(len(stars)), [stamp], [len(stars)],
                              models.observer(setting.observer))
        r_s = u_i @ C_si[k].T
        front = np.flatnonzero(r_s[:, 2] > 0.01)
        uv = camera.project(r_s[front], truth.intrinsics, truth.detector.pitch_mm)
        expected = front[truth.detector.contains(uv)] + 1
        seen = frames.catalog_id[frames.first[k]:frames.first[k + 1]]
        np.testing.assert_array_equal(np.sort(seen), expected)


def test_corners_behind_a_strong_barrel_show_the_sky_as_densely_as_the_middle(barrel):
    """Stars over solid angle, of 100 pixels to each side of a corner and in the middle."""
    _, truth, stars, frames = barrel
    uv = frames.uv_raster - truth.detector.centre_raster
    grid = np.stack(np.meshgrid(*(np.arange(-512.0, 513.0, 4.0),) * 2), axis=-1)
    sky = camera.unproject(grid.reshape(-1, 2), truth.intrinsics, truth.detector.pitch_mm,
                           steps=50).reshape(grid.shape[:2] + (3,))
    across = np.cross(np.diff(sky, axis=0)[:, :-1], np.diff(sky, axis=1)[:-1])
    solid, middle = np.linalg.norm(across, axis=-1), grid[:-1, :-1] + 2.0
    for where in (lambda at: (np.abs(at) > 412.0).all(axis=-1),
                  lambda at: (np.abs(at) < 200.0).all(axis=-1)):
        expected = len(stars) / (4.0 * np.pi) * solid[where(middle)].sum() * len(frames)
        assert where(uv).sum() / expected == pytest.approx(1.0, abs=0.1)


def test_field_reaches_to_the_farthest_corner(barrel):
    _, truth, _, _ = barrel
    corners = np.array([[u, v] for u in (-512.0, 512.0) for v in (-512.0, 512.0)])
    rays = camera.unproject(corners, truth.intrinsics, truth.detector.pitch_mm, steps=50)
    field = camera.field_of_view(truth.detector, truth.intrinsics)
    farthest = np.arccos(rays[:, 2]).max()
    assert farthest > 60.0 * DEG and field.whole
    assert 1.0 <= field.radius / farthest < 1.02


def test_lens_that_folds_back_before_the_corner_shows_what_it_can_and_says_so():
    """``1 + 3 k1 r^2 = 0`` at 2.58 mm: beyond it the polynomial comes back."""
    setting = TAN2018.replace({**BARREL, 'truth.camera.distortion': (-0.05, 0.0, 0.0, 0.0),
                               'truth.star_tracker.centroid_sigma_px': 0.0})
    truth = Truth.from_scenario(setting)
    fold = np.arctan(np.sqrt(1.0 / 0.15) / 4.0)
    with pytest.warns(UserWarning, match='truth.camera.distortion: folds back.* 33.0 deg'):
        simulator = StarTrackerSimulator(setting, truth, random_sky(2000),
                                         np.random.default_rng(1))
    frames = simulator.next(20)
    stars, C_si = random_sky(2000), truth.attitude_si(frames.stamp_ns)
    off = np.arccos([C_si[k, 2] @ apparent_places(
        stars, np.array([row]), [frames.stamp_ns[k]], [1], models.observer(setting.observer))[0]
        for k, row in zip(frames.frame_index, frames.catalog_id - 1)])
    assert 0.97 * fold < off.max() < fold
    # as many as a cap of that radius has, but for what lies outside the detector
    assert len(off) / len(frames) == pytest.approx(1000.0 * (1.0 - np.cos(fold)), rel=0.2)


def test_a_star_on_the_boresight_falls_on_the_middle_of_the_raster():
    frame = pole()
    np.testing.assert_allclose(frame.uv_raster, [[499.5, 300.0]], atol=1e-11)
    assert frame.catalog_id.tolist() == [7]


def test_a_star_on_the_boresight_falls_on_the_principal_point():
    frame = pole(**{'camera.principal_point_px': (3.0, -4.0)})
    np.testing.assert_allclose(frame.uv_raster, [[502.5, 296.0]], atol=1e-11)


def test_a_star_at_the_limiting_magnitude_is_seen_and_a_fainter_one_is_not():
    assert len(pole(1.0).uv_raster) == 1
    assert len(pole(0.999).uv_raster) == 0


def test_a_frame_without_stars_is_empty():
    frames = tracker_of(**{'star_tracker.limiting_magnitude': -2.0}).next(3)
    assert frames.star_counts.tolist() == [0, 0, 0]
    assert frames.first.tolist() == [0, 0, 0, 0]
    assert frames.uv_raster.shape == (0, 2)


def test_the_two_sensors_see_the_same_truth(truth):
    """Stars of a frame at 50 s, predicted by gyro readings from the attitude at 0 s."""
    frame = tracker_of().next(101)[100:]
    samples = gyro_of(**UNBIASED).next(5000)
    assert samples.stamp_ns[-1] == frame.stamp_ns[0]
    cuts = np.array([truth.motion.start_ns, frame.stamp_ns[0]])
    Delta = preintegrate(samples, cuts, np.zeros(3), 1e7).Delta[0]
    assert np.linalg.norm(rotation.log(Delta)) > 9.0 * DEG
    stars = catalog.load_containing(frame.catalog_id)
    u_i = apparent_places(stars, stars.rows(frame.catalog_id), frame.stamp_ns,
                          frame.star_counts, models.observer(TAN2018.observer))
    r_s = u_i @ (truth.C_sg @ Delta @ truth.motion.attitude(cuts[:1])[0].T).T
    uv = camera.project(r_s, truth.intrinsics, truth.detector.pitch_mm)
    # 5000 steps of some 1e-16 rad, 4000 px/rad
    np.testing.assert_allclose(uv + truth.detector.centre_raster, frame.uv_raster, atol=1e-8)


# Randomness

@pytest.mark.parametrize('make', [sensors.gyro, sensors.star_tracker], ids=['gyro', 'tracker'])
@pytest.mark.parametrize('sizes', [(1,) * 50, (7, 0, 13, 1, 29), (600, 5)],
                         ids=['one', 'odd', 'many'])
def test_readings_are_the_same_to_the_bit_whatever_the_batches(make, sizes):
    whole = make(TAN2018).next(sum(sizes))
    simulator = make(TAN2018)
    parts = [simulator.next(size) for size in sizes]
    assert same(type(whole).concatenate(parts), whole)


@pytest.mark.parametrize('make', [sensors.gyro, sensors.star_tracker], ids=['gyro', 'tracker'])
def test_a_run_ends_at_its_duration(make):
    simulator = make(TAN2018.replace({'simulation.duration_s': 3.0}))
    assert len(simulator.next(10**6)) == simulator.count
    assert len(simulator.next(10)) == 0


def test_another_seed_gives_other_noise():
    other = TAN2018.replace({'simulation.seed': 2})
    for make, name in ((sensors.gyro, 'rate'), (sensors.star_tracker, 'uv_raster')):
        first, second = (getattr(make(setting).next(10), name) for setting in (TAN2018, other))
        assert not np.isin(first, second).any()


def test_the_sensors_draw_from_streams_of_their_own():
    """The first numbers of each, the noise over its sigma, have none in common."""
    gyro = sensors.gyro(TAN2018)
    n_gyro = (gyro.next(20).rate - 0.01 * DEG_PER_HOUR) / np.sqrt(gyro.rate_variance)
    n_tracker = (sensors.star_tracker(TAN2018).next(1).uv_raster
                 - tracker_of().next(1).uv_raster) / 0.05
    # both good to better than 1e-6, of some 60 and 50 numbers of size 1
    assert np.abs(n_gyro.reshape(-1, 1) - n_tracker.ravel()).min() > 1e-6


# Truth

def test_truth_is_that_of_the_group_truth(truth):
    np.testing.assert_array_equal(truth.intrinsics, [5.0, 10.0, 25.6, 2e-4, -1e-6, 2e-5, 2e-5])
    np.testing.assert_allclose(truth.bias, 0.01 * DEG_PER_HOUR, rtol=1e-15)
    np.testing.assert_array_equal(
        truth.C_sg, rotation.from_fixed_angles(np.radians([-0.1, 30.0, 359.8])))


def test_truth_falls_back_to_the_nominal_values():
    nominal = Scenario().replace({
        'camera.principal_point_px': (1.0, 2.0), 'camera.distortion': (1e-4, 0.0, 0.0, 1e-5),
        'gyro.bias_deg_h': (1.0, 2.0, 3.0), 'mounting.fixed_angles_deg': (1.0, 2.0, 3.0),
        'truth.camera.focal_length_mm': 26.0})
    truth = Truth.from_scenario(nominal)
    np.testing.assert_array_equal(truth.intrinsics, [1.0, 2.0, 26.0, 1e-4, 0.0, 0.0, 1e-5])
    np.testing.assert_allclose(truth.bias, np.array([1.0, 2.0, 3.0]) * DEG_PER_HOUR, rtol=1e-15)
    np.testing.assert_array_equal(truth.C_sg,
                                  rotation.from_fixed_angles(np.radians([1.0, 2.0, 3.0])))


def test_a_true_value_of_zero_is_not_one_that_is_left_out():
    zero = Truth.from_scenario(Scenario().replace({
        'gyro.bias_deg_h': (1.0, 2.0, 3.0), 'truth.gyro.bias_deg_h': (0.0, 0.0, 0.0),
        'mounting.fixed_angles_deg': (1.0, 2.0, 3.0),
        'truth.mounting.fixed_angles_deg': (0.0, 0.0, 0.0),
        'camera.principal_point_px': (1.0, 2.0), 'truth.camera.principal_point_px': (0.0, 0.0)}))
    np.testing.assert_array_equal(zero.bias, 0.0)
    np.testing.assert_array_equal(zero.C_sg, np.eye(3))
    np.testing.assert_array_equal(zero.intrinsics[:2], 0.0)


def test_tracker_attitude_is_the_mounting_after_the_gyros_attitude(truth):
    stamps = truth.motion.start_ns + np.array([0, 47 * 10**9])
    C_ig = truth.motion.attitude(stamps)
    for k, C_si in enumerate(truth.attitude_si(stamps)):
        np.testing.assert_allclose(C_si @ C_ig[k], truth.C_sg, atol=ROUNDING)


def test_dictionary_and_vector_of_the_truth_agree(truth):
    values, vector = truth.as_dict(), truth.vector()
    mounting = values['mounting']
    assert vector.shape == (13,)
    np.testing.assert_allclose(values['gyro_bias_deg_h'], vector[:3] / DEG_PER_HOUR, rtol=1e-15)
    np.testing.assert_allclose(mounting['fixed_angles_deg'], np.degrees(vector[3:6]), rtol=1e-15)
    np.testing.assert_allclose(mounting['fixed_angles_deg'], [-0.1, 30.0, -0.2], rtol=1e-12)
    np.testing.assert_allclose(rotation.to_matrix(np.array(mounting['quaternion_xyzw'])),
                               truth.C_sg, atol=ROUNDING)
    assert list(values['intrinsics']) == ['u0_px', 'v0_px', 'f_mm', 'k1', 'k2', 'p1', 'p2']
    np.testing.assert_array_equal(list(values['intrinsics'].values()), vector[6:])
