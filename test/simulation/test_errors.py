# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The errors of the group truth: off they change no bit, on each does what it says, no more."""

from dataclasses import fields

import erfa
import numpy as np
import pytest
from scipy.stats import binom, chi2

from instruments import PITCH_MM, TAN2018
from starcal_ros.config import models, parameter_file
from starcal_ros.config.instrument import ObserverConfig
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.truth import TrueObserverConfig, sources
from starcal_ros.core import camera, rotation
from starcal_ros.core.units import ARCSEC, DEG, DEG_PER_HOUR, DEG_PER_SQRT_HOUR
from starcal_ros.simulation import sensors
from starcal_ros.simulation.errors import examples, hot_pixels, smear
from starcal_ros.simulation.process import Process
from starcal_ros.simulation.randomness import stream
from starcal_ros.simulation.star_images import instants_ns
from starcal_ros.simulation.star_tracker import StarTrackerSimulator
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import Observer, apparent_places

QUIET = TAN2018.replace({'truth.gyro.arw_deg_sqrt_h': 0.0,
                         'truth.star_tracker.centroid_sigma_px': 0.0})
SOURCES = {source.__name__.rpartition('.')[2]: source for source in sources()}
GYRO_HOOKS, TRACKER_HOOKS = {'bias', 'rate', 'readings'}, {'mounting', 'images', 'frames'}


def seen_by(hooks):
    """Return the settings with which the sources that have one of these hooks are on, by label."""
    return {label: values for source in SOURCES.values() if hooks & set(vars(source))
            for label, values in examples(source).items()}


GYRO_ERRORS = {'noisy gyro': {'truth.gyro.arw_deg_sqrt_h': 0.01}, **seen_by(GYRO_HOOKS)}
TRACKER_ERRORS = {
    'noisy centroids': {'truth.star_tracker.centroid_sigma_px': 0.1},
    'late': {'truth.star_tracker.time_offset_s': 0.02},
    'in orbit': {'truth.observer.velocity': 'orbit'},
    **seen_by(TRACKER_HOOKS),
}
ERRORS = {**GYRO_ERRORS, **TRACKER_ERRORS}
ALL_ERRORS = {key: value for values in ERRORS.values() for key, value in values.items()}
SEEDS = range(200)
# Frames 62 to 179 and more lie in the first slew, 0.5 deg/s about x, steady from 31 s to 90 s.
STEADY = slice(64, 178)


def same(a, b):
    return all(np.array_equal(getattr(a, field.name), getattr(b, field.name))
               for field in fields(a))


def gyro_of(setting, count, **errors):
    return sensors.gyro(setting.replace({f'truth.gyro.{k}': v for k, v in errors.items()})
                        ).next(count)


def tracker_of(setting, count, **errors):
    return sensors.star_tracker(setting.replace(
        {f'truth.star_tracker.{k}': v for k, v in errors.items()})).next(count)


def images(setting, frames, early_ns=0, places_early_ns=None):
    """Return where the stars of the frames are, in raster pixels, some time before the stamps."""
    truth, stars = Truth.from_scenario(setting), catalog.load(8.0)
    places_early_ns = early_ns if places_early_ns is None else places_early_ns
    u_i = apparent_places(
        stars, stars.rows(frames.catalog_id), frames.stamp_ns - places_early_ns,
        frames.star_counts, models.observer(setting.observer, setting.truth.observer))
    C_si = truth.attitude_si(frames.stamp_ns - early_ns)[frames.frame_index]
    return camera.project((C_si @ u_i[..., None])[..., 0], truth.intrinsics,
                          truth.detector.pitch_mm) + truth.detector.centre_raster


def chi_square_interval(degrees):
    return chi2.ppf([0.0005, 0.9995], degrees)


def assert_unit_variance(samples):
    """Check that the sum of squares of independent unit normals is in its 99.9 % interval."""
    low, high = chi_square_interval(samples.size)
    assert low < np.sum(samples**2) < high


# All off

def test_with_every_error_off_a_reading_is_that_of_the_plain_model():
    """G.1 of gyro.py without its errors, written out; to the bit."""
    samples, truth = sensors.gyro(TAN2018).next(5000), Truth.from_scenario(TAN2018)
    rng = np.random.default_rng(np.random.SeedSequence(1, spawn_key=(1,)))
    stamps = truth.motion.start_ns + 10**7 * np.arange(5001)
    C_ig = truth.motion.attitude(stamps)
    theta = rotation.log(np.swapaxes(C_ig[:-1], -1, -2) @ C_ig[1:])
    noise = 0.001 * DEG_PER_SQRT_HOUR / np.sqrt(0.01) * rng.standard_normal((5000, 3))
    np.testing.assert_array_equal(samples.rate, theta / 0.01 + truth.bias + noise)


def test_with_every_error_off_a_centroid_is_that_of_the_plain_model():
    """T18 Eq. 5 and 6, written out; to the bit."""
    frames, truth = sensors.star_tracker(TAN2018).next(300), Truth.from_scenario(TAN2018)
    rng = np.random.default_rng(np.random.SeedSequence(1, spawn_key=(0,)))
    stars = catalog.load(TAN2018.star_tracker.limiting_magnitude)
    u_i = apparent_places(stars, stars.rows(frames.catalog_id), frames.stamp_ns,
                          frames.star_counts, models.observer(TAN2018.observer))
    C_gi = np.swapaxes(truth.motion.attitude(frames.stamp_ns), -1, -2)
    r_s = ((truth.C_sg @ C_gi)[frames.frame_index] @ u_i[..., None])[..., 0]
    uv = camera.project(r_s, truth.intrinsics, truth.detector.pitch_mm)
    uv = uv + 0.05 * rng.standard_normal(uv.shape)
    np.testing.assert_array_equal(frames.uv_raster, uv + truth.detector.centre_raster)


def test_true_noise_that_is_left_out_is_nominal():
    stated = TAN2018.replace({'truth.gyro.arw_deg_sqrt_h': 0.001,
                              'truth.star_tracker.centroid_sigma_px': 0.05})
    assert same(gyro_of(stated, 100), gyro_of(TAN2018, 100))
    assert same(tracker_of(stated, 10), tracker_of(TAN2018, 10))


@pytest.mark.parametrize('label', ERRORS)
def test_an_error_is_seen_by_its_own_sensor_alone(label):
    wrong = TAN2018.replace(ERRORS[label])
    assert same(gyro_of(wrong, 5000), gyro_of(TAN2018, 5000)) == (label not in GYRO_ERRORS)
    assert same(tracker_of(wrong, 100), tracker_of(TAN2018, 100)) == (label not in TRACKER_ERRORS)


@pytest.mark.parametrize('label', ERRORS)
def test_no_error_changes_the_constants_or_the_attitude_of_the_truth(label):
    truth, wrong = (Truth.from_scenario(s) for s in (TAN2018, TAN2018.replace(ERRORS[label])))
    np.testing.assert_array_equal(wrong.vector(), truth.vector())
    stamps = truth.motion.start_ns + 10**9 * np.arange(100)
    np.testing.assert_array_equal(wrong.motion.attitude(stamps), truth.motion.attitude(stamps))


def test_every_source_has_a_hook_and_settings_of_its_own():
    labels = [label for source in SOURCES.values() for label in source.ON]
    assert labels and len(set(labels)) == len(labels)
    for name, source in SOURCES.items():
        assert source.ON and (GYRO_HOOKS | TRACKER_HOOKS) & set(vars(source)), name


def test_smear_comes_before_other_sources_that_move_the_images():
    """It begins with the trail, not with what another has made of the image."""
    assert next(name for name, source in SOURCES.items() if hasattr(source, 'images')) == 'smear'


# Randomness

@pytest.mark.parametrize('make', [sensors.gyro, sensors.star_tracker], ids=['gyro', 'tracker'])
@pytest.mark.parametrize('sizes', [(1,) * 50, (7, 0, 13, 1, 29), (600, 5), (5, 8000)],
                         ids=['one', 'odd', 'many', 'long'])
def test_errors_are_the_same_to_the_bit_whatever_the_batches(make, sizes):
    wrong = TAN2018.replace(ALL_ERRORS)
    whole, simulator = make(wrong).next(sum(sizes)), make(wrong)
    parts = [simulator.next(size) for size in sizes]
    assert same(type(whole).concatenate(parts), whole)


DRAWN = {name: source for name, source in SOURCES.items() if hasattr(source, 'stream')}


@pytest.mark.parametrize('name', DRAWN)
def test_an_error_is_another_with_another_seed(name):
    for values in examples(DRAWN[name]).values():
        one, again, other = (
            (gyro_of(setting, 1000), tracker_of(setting, 100)) for setting in (
                QUIET.replace({**values, 'simulation.seed': seed}) for seed in (1, 1, 2)))
        assert all(map(same, one, again))
        assert not all(map(same, one, other))


def test_a_longer_run_begins_like_a_shorter_one():
    long = TAN2018.replace(ALL_ERRORS)
    short = long.replace({'simulation.duration_s': 60.0})
    assert same(gyro_of(short, 6000), gyro_of(long, 6000))
    assert same(tracker_of(short, 120), tracker_of(long, 120))


def test_streams_differ_by_name_and_from_those_of_the_sensors():
    first = [stream(TAN2018, name).random() for name in DRAWN]
    first += [np.random.default_rng(np.random.SeedSequence(1, spawn_key=(sensor,))).random()
              for sensor in (0, 1)]
    assert len(set(first)) == len(DRAWN) + 2


@pytest.mark.parametrize('name', DRAWN)
def test_a_source_draws_from_the_stream_of_its_name_alone(name, monkeypatch):
    """So none that is switched on takes numbers from another."""
    asked = set()

    def watched(scenario, source):
        asked.add(source)
        return stream(scenario, source)

    monkeypatch.setattr(DRAWN[name], 'stream', watched)
    wrong = TAN2018.replace(ALL_ERRORS)
    gyro_of(wrong, 10), tracker_of(wrong, 10)
    assert asked == {name}


@pytest.mark.parametrize('label', seen_by(GYRO_HOOKS))
def test_a_gyro_error_leaves_the_noise_as_it_was(label):
    """What the noise adds to a reading, to the rounding of rates of 0.5 deg/s."""
    right, wrong = (gyro_of(TAN2018.replace(values), 5000).rate
                    - gyro_of(QUIET.replace(values), 5000).rate for values in ({}, ERRORS[label]))
    np.testing.assert_allclose(wrong, right, rtol=0.0, atol=1e-17)


@pytest.mark.parametrize('label', seen_by({'frames'}))
def test_an_error_of_the_frames_leaves_the_noise_as_it_was(label):
    """The sensor has drawn as many numbers, for the same stars."""
    stars, ends = catalog.load(TAN2018.star_tracker.limiting_magnitude), []
    for setting in (TAN2018, TAN2018.replace(ERRORS[label])):
        rng = np.random.default_rng(7)
        StarTrackerSimulator(setting, Truth.from_scenario(setting), stars, rng).next(50)
        ends.append(rng.bit_generator.state)
    assert ends[0] == ends[1]


def test_a_process_is_linear_between_its_grid_points_and_stands_still_beyond():
    process = Process(10**9, 2.0, np.array([[0.0, 0.0, 0.0], [2.0, -4.0, 1.0]]))
    np.testing.assert_allclose(
        process.at(10**9 + np.array([-5, 0, 1, 2, 9]) * 10**9),
        [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, -2.0, 0.5], [2.0, -4.0, 1.0], [2.0, -4.0, 1.0]])


# Gyro

def test_true_random_walk_scatters_the_readings_and_the_stated_variance_is_nominal():
    """At rest; N = 0.01 deg/sqrt(h) at 100 Hz, N^2 / dt."""
    wrong = TAN2018.replace({'truth.gyro.arw_deg_sqrt_h': 0.01})
    noise = gyro_of(wrong, 3000).rate - 0.01 * DEG_PER_HOUR
    assert_unit_variance(noise / (0.01 * DEG_PER_SQRT_HOUR / np.sqrt(0.01)))
    assert sensors.gyro(wrong).rate_variance == sensors.gyro(TAN2018).rate_variance


@pytest.mark.parametrize('row', [3500, 12500, 21500], ids=['x', 'y', 'z'])
def test_scale_factors_and_misalignment_are_a_matrix_on_the_rate(row):
    """In the slews about x, y and z; one by one the columns of I + M."""
    M = np.array([[10e-6, 1.0 * ARCSEC, 2.0 * ARCSEC],
                  [3.0 * ARCSEC, -20e-6, 4.0 * ARCSEC],
                  [5.0 * ARCSEC, 6.0 * ARCSEC, 30e-6]])
    wrong = gyro_of(QUIET, 25_000, scale_factor_ppm=(10.0, -20.0, 30.0),
                    misalignment_arcsec=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)).rate[row]
    right = gyro_of(QUIET, 25_000).rate[row]
    axis = (row - 3500) // 9000
    np.testing.assert_allclose(wrong - right, 0.5 * DEG * M[:, axis], atol=1e-12)


def test_bias_starts_at_its_constant_value_and_walks_with_the_variance_of_a_random_walk():
    """Variance K^2 t of b(t) - b(0), each axis, and K^2 (t - t') of what came between."""
    K = 0.1 * DEG_PER_HOUR / np.sqrt(3600.0)
    t = np.array([0, 1, 60, 7200])
    bias = []
    for seed in SEEDS:
        truth = Truth.from_scenario(TAN2018.replace({
            'truth.gyro.bias_random_walk_deg_h_sqrt_h': 0.1, 'simulation.seed': seed}))
        bias.append(truth.bias_at(truth.motion.start_ns + t * 10**9))
    bias = np.array(bias)
    np.testing.assert_allclose(bias[:, 0], 0.01 * DEG_PER_HOUR, rtol=1e-15)
    for k in range(1, len(t)):
        assert_unit_variance((bias[:, k] - bias[:, 0]) / (K * np.sqrt(t[k])))
        assert_unit_variance((bias[:, k] - bias[:, k - 1]) / (K * np.sqrt(t[k] - t[k - 1])))


def test_a_reading_has_the_bias_of_the_middle_of_its_interval():
    wrong = QUIET.replace({'truth.gyro.bias_random_walk_deg_h_sqrt_h': 100.0})
    samples = gyro_of(wrong, 3000)
    bias = Truth.from_scenario(wrong).bias_at(samples.stamp_ns - 5 * 10**6)
    assert np.ptp(bias, axis=0).min() > DEG_PER_HOUR
    # at rest; a turn is good to 1e-15 rad, over 10 ms
    np.testing.assert_allclose(samples.rate, bias, atol=1e-12)


# Star tracker: noise, time, observer

def test_true_centroid_noise_scatters_the_stars_and_the_stated_sigma_is_nominal():
    quiet = tracker_of(QUIET, 200)
    noisy = tracker_of(TAN2018, 200, centroid_sigma_px=0.3)
    assert_unit_variance((noisy.uv_raster - quiet.uv_raster) / 0.3)
    for frames in (quiet, noisy):
        np.testing.assert_array_equal(frames.sigma, 0.05)


@pytest.mark.parametrize('offset_s', [-0.05, 0.05, 10.0])
def test_a_late_stamp_is_on_the_sky_of_before(offset_s):
    frames = tracker_of(QUIET, 200, time_offset_s=offset_s)
    np.testing.assert_array_equal(frames.stamp_ns, tracker_of(QUIET, 200).stamp_ns)
    # sums of three products in another order: 1e-16 of directions, 4000 px/rad
    np.testing.assert_allclose(frames.uv_raster, images(QUIET, frames, round(offset_s * 1e9)),
                               atol=1e-11)


def test_in_a_slew_a_time_offset_shifts_the_stars_by_rate_times_offset():
    """0.5 deg/s x 0.05 s = 0.025 deg on 3969 px/rad, about an axis far from the boresight."""
    frames = tracker_of(QUIET, 200, time_offset_s=0.05)[STEADY]
    shift = np.linalg.norm(frames.uv_raster - images(QUIET, frames, 0), axis=1)
    C_sg = Truth.from_scenario(QUIET).C_sg
    across = np.hypot(*C_sg[:2, 0])             # of the turn about x, what moves the boresight
    expected = across * 0.025 * DEG * 25.6 / PITCH_MM
    # 7.3 deg off the boresight: 1 / cos^2 stretches by 2.6 % at most, distortion 3 px by 2 %
    np.testing.assert_allclose(np.median(shift), expected, rtol=0.05)


def test_an_orbit_that_nobody_believes_in_aberrates_the_stars_by_5_arcsec():
    """At most v / c = 7.617 km/s / c = 5.24", reached where the camera looks across the orbit."""
    setting = QUIET.replace({'star_tracker.rate_hz': 1.0 / 60.0})
    truth = Truth.from_scenario(setting)
    frames = sensors.star_tracker(setting.replace({
        'truth.observer.velocity': 'orbit', 'truth.observer.altitude_km': 500.0})).next(95)
    seen, believed = (camera.unproject(uv - truth.detector.centre_raster, truth.intrinsics,
                                       truth.detector.pitch_mm)
                      for uv in (frames.uv_raster, images(setting, frames)))
    shift = np.linalg.norm(np.cross(seen, believed), axis=1)
    v_over_c = Observer('orbit', 500.0).mean_motion * 6878136.6 / 299792458.0
    np.testing.assert_allclose(v_over_c / ARCSEC, 5.24, atol=0.005)
    # the Earth's own motion, 1e-4 c, makes 1 + 1e-4 of it; 60 s of the orbit are 3.8 deg
    assert 0.998 * v_over_c < shift.max() < 1.0002 * v_over_c


def test_the_true_observer_has_the_nominal_elements_that_it_leaves_out():
    nominal = ObserverConfig(altitude_km=700.0, raan_deg=10.0)
    assert models.observer(nominal, TrueObserverConfig()) == models.observer(nominal)
    true = models.observer(nominal, TrueObserverConfig(velocity='orbit', raan_deg=0.0))
    assert true == Observer('orbit', altitude_km=700.0, raan_deg=0.0)


# Star tracker: smear

@pytest.mark.parametrize('offset_s', [0.0, -0.01413], ids=['symmetric', 'worst'])
def test_a_smeared_centroid_is_the_mean_of_many_sub_exposures(offset_s):
    """Through rest, ramp and slew, against 1000 sub-exposures of 0.18 ms.

    The mean of 1000 places differs from the integral by 1e-6 of 0.18 s squared times the
    acceleration, the five points by 3.9e-4 of it at most where a slew begins (14 ms before the
    middle): 3.9e-4 x 0.0324 s^2 x 0.5 deg/s^2 x 3969 px/rad = 4.4e-4 px, 5 % more at the edge.
    """
    frames = tracker_of(QUIET, 70, smear=True, time_offset_s=offset_s)[58:]
    middle = round(offset_s * 1e9)
    brute = np.mean([
        images(QUIET, frames, middle - round(t * 1e9), middle)
        for t in 0.18 * ((np.arange(1000) + 0.5) / 1000 - 0.5)], axis=0)
    error = np.linalg.norm(frames.uv_raster - brute, axis=1)
    assert error.max() < 4.8e-4
    steady = frames.frame_index >= 7           # from 32.5 s on
    assert error[steady].max() < 1e-7           # whole nanoseconds, of 35 px/s


def test_stars_at_rest_do_not_smear():
    """Nor does their noise; to the rounding of sums of 1000 px.

    Without the first frame, whose exposure begins before the run, in the slew of a cycle before.
    """
    still, smeared = (tracker_of(TAN2018, 60, smear=on)[1:] for on in (False, True))
    np.testing.assert_array_equal(smeared.catalog_id, still.catalog_id)
    np.testing.assert_allclose(smeared.uv_raster, still.uv_raster, atol=1e-11)


def test_smear_spreads_the_noise_along_the_trail_by_its_length_and_not_across():
    """1 + L^2 / (12 s^2), from the ends of the trails."""
    quiet = tracker_of(QUIET, 200, smear=True)[STEADY]
    noisy = tracker_of(TAN2018, 200, smear=True)[STEADY]
    np.testing.assert_array_equal(noisy.catalog_id, quiet.catalog_id)
    ends = [images(QUIET, quiet, early, 0) for early in (-9 * 10**7, 9 * 10**7)]
    trail = ends[0] - ends[1]
    length = np.linalg.norm(trail, axis=1)
    assert 3.0 < length.min() < length.max() < 7.0
    along = trail / length[:, None]
    across = np.stack((-along[:, 1], along[:, 0]), axis=1)
    noise = noisy.uv_raster - quiet.uv_raster
    assert_unit_variance(np.sum(noise * across, axis=1) / 0.05)
    sigma = 0.05 * np.sqrt(1.0 + length**2 / (12.0 * smear.SPOT_SIGMA_PX**2))
    assert_unit_variance(np.sum(noise * along, axis=1) / sigma)


def test_a_steady_trail_has_a_twelfth_of_its_length_squared():
    """Exact to rounding: the sums of five points are exact for powers up to the seventh."""
    ends = np.array([[3.0, 4.0], [0.0, 0.0]])
    t = np.array(instants_ns(1.0)) * 1e-9
    factor = smear.noise_factor(t[:, None, None] * ends)
    S = np.outer(ends[0], ends[0]) / 12.0 / smear.SPOT_SIGMA_PX**2
    np.testing.assert_allclose(factor[0] @ factor[0].T, np.eye(2) + S, rtol=1e-8)
    np.testing.assert_array_equal(factor[1], np.eye(2))


# Star tracker: drift

def drifts(t, **more):
    """Return Psi / sigma of many seeds, (seeds, times, 3)."""
    setting = TAN2018.replace({'truth.mounting_drift.sigma_arcsec': 10.0,
                               'truth.mounting_drift.time_constant_s': 100.0, **more})
    truths = [Truth.from_scenario(setting.replace({'simulation.seed': seed})) for seed in SEEDS]
    return np.array([truth.drifts[0](truth.motion.start_ns + np.array(t) * 10**9)
                     for truth in truths]) / (10.0 * ARCSEC)


@pytest.mark.slow
@pytest.mark.parametrize('t', [0, 50, 7200])
def test_drift_is_stationary_from_the_start(t):
    assert_unit_variance(drifts([t]))


@pytest.mark.slow
def test_drift_is_correlated_by_the_exponential_of_the_lag():
    """Of n pairs a correlation r has the standard deviation (1 - r^2) / sqrt(n)."""
    lags = np.array([1, 10, 50, 100, 200])
    Psi = drifts([1000, *(1000 + lags)])
    n = Psi[:, 0].size
    for k, expected in enumerate(np.exp(-lags / 100.0), start=1):
        found = np.corrcoef(Psi[:, 0].ravel(), Psi[:, k].ravel())[0, 1]
        assert abs(found - expected) < 3.3 * (1.0 - expected**2) / np.sqrt(n)


@pytest.mark.slow
def test_the_axes_drift_apart():
    Psi = drifts([100])[:, 0]
    correlation = np.corrcoef(Psi.T)[np.triu_indices(3, 1)]
    assert np.abs(correlation).max() < 3.9 / np.sqrt(len(Psi))         # 99.99 %


def test_drift_turns_the_star_tracker_about_its_axes():
    """T18 Eq. 8: C_sg(t) = (I + [Psi x]) C_sg."""
    setting = QUIET.replace({'truth.mounting_drift.sigma_arcsec': 10.0,
                             'truth.mounting_drift.time_constant_s': 100.0})
    frames, truth = tracker_of(setting, 200), Truth.from_scenario(setting)
    stars = catalog.load(8.0)
    u_i = apparent_places(stars, stars.rows(frames.catalog_id), frames.stamp_ns,
                          frames.star_counts, models.observer(setting.observer))
    C_gi = np.swapaxes(truth.motion.attitude(frames.stamp_ns), -1, -2)
    Psi = truth.drifts[0](frames.stamp_ns)
    C_si = (np.eye(3) + rotation.skew(Psi)) @ truth.C_sg @ C_gi
    uv = camera.project((C_si[frames.frame_index] @ u_i[..., None])[..., 0], truth.intrinsics,
                        truth.detector.pitch_mm) + truth.detector.centre_raster
    # second order: (40 arcsec)^2 / 2 = 2e-8 rad, 4000 px/rad
    np.testing.assert_allclose(frames.uv_raster, uv, atol=1e-4)
    still = images(QUIET, frames)
    assert np.abs(frames.uv_raster - still).max() > 0.2                # 10 arcsec


def test_drift_and_smear_go_together():
    """Each instant of an exposure has its own mounting, as in 100 sub-exposures.

    At rest, half-way between the drift's grid points, which are 1 s apart: no corner is met.
    """
    setting = QUIET.replace({'truth.mounting_drift.sigma_arcsec': 3600.0,
                             'truth.mounting_drift.time_constant_s': 100.0})
    frames = tracker_of(setting, 40, smear=True)
    brute = np.mean([images(setting, frames, round(t * 1e9), 0)
                     for t in 0.18 * ((np.arange(100) + 0.5) / 100 - 0.5)], axis=0)
    between = frames.frame_index % 2 == 1
    # both exact but for whole nanoseconds, of some 10 px/s, and sums of some 1000 px
    np.testing.assert_allclose(frames.uv_raster[between], brute[between], atol=1e-7)
    assert np.abs(brute - images(setting, frames)).max() > 1e-3


# Star tracker: misidentified stars and hot pixels

def test_a_misidentified_star_has_its_nearest_neighbours_number():
    right = tracker_of(TAN2018, 1200)
    wrong = tracker_of(TAN2018, 1200, misidentified_fraction=0.1)
    for name in ('stamp_ns', 'first', 'uv_raster', 'sigma', 'magnitude'):
        np.testing.assert_array_equal(getattr(wrong, name), getattr(right, name))
    mistaken = wrong.catalog_id != right.catalog_id
    low, high = binom.ppf([0.0005, 0.9995], len(mistaken), 0.1)
    assert low < mistaken.sum() < high
    stars = catalog.load(TAN2018.star_tracker.limiting_magnitude)
    direction = erfa.s2c(stars.ra, stars.dec)
    pairs = np.unique(np.stack((right.catalog_id, wrong.catalog_id))[:, mistaken], axis=1)
    for row, taken in stars.rows(pairs).T:
        cosine = direction @ direction[row]
        assert taken == np.argsort(cosine)[-2]


def test_all_stars_may_be_misidentified():
    right = tracker_of(TAN2018, 10)
    wrong = tracker_of(TAN2018, 10, misidentified_fraction=1.0)
    assert (wrong.catalog_id != right.catalog_id).all()


def test_hot_pixels_stand_still_behind_the_stars_of_each_frame():
    plain = tracker_of(TAN2018, 700)
    frames = tracker_of(TAN2018, 700, hot_pixels_per_frame=20)
    np.testing.assert_array_equal(frames.star_counts, plain.star_counts + 20)
    rank = np.arange(len(frames.sigma)) - frames.first[frames.frame_index]
    hot = rank >= plain.star_counts[frames.frame_index]
    for name in ('uv_raster', 'sigma', 'magnitude', 'catalog_id'):
        np.testing.assert_array_equal(getattr(frames, name)[~hot], getattr(plain, name))
    places = frames.uv_raster[hot].reshape(700, 20, 2)
    np.testing.assert_array_equal(places, np.broadcast_to(places[0], places.shape))
    assert len(np.unique(places[0], axis=0)) == 20
    np.testing.assert_array_equal(places, np.rint(places))
    assert places.min() >= 0.0 and places.max() <= 1023.0
    np.testing.assert_array_equal(frames.sigma[hot], 0.05)
    np.testing.assert_array_equal(frames.magnitude[hot], 6.4)


def test_a_hot_pixel_has_the_number_of_the_nearest_star_within_the_search_radius():
    frames = tracker_of(TAN2018, 1200, hot_pixels_per_frame=100)
    named = 0
    for k in range(len(frames)):
        frame = frames[k:k + 1]
        star, hot = frame.uv_raster[:-100], frame.uv_raster[-100:]
        distance = np.linalg.norm(hot[:, None] - star, axis=2)
        nearest = frame.catalog_id[:-100][np.argmin(distance, axis=1)]
        expected = np.where(distance.min(axis=1) < hot_pixels.SEARCH_PX, nearest, 0)
        np.testing.assert_array_equal(frame.catalog_id[-100:], expected)
        named += np.count_nonzero(expected)
    # about 24 stars x pi 5^2 px^2 of 1024^2 px^2, 120,000 times: 216; stars cluster in time
    assert 100 < named < 400


def test_hot_pixels_do_not_change_who_is_misidentified():
    wrong = tracker_of(TAN2018, 50, misidentified_fraction=0.5)
    both = tracker_of(TAN2018, 50, misidentified_fraction=0.5, hot_pixels_per_frame=1)
    star = np.ones(len(both.sigma), bool)
    star[both.first[1:] - 1] = False
    np.testing.assert_array_equal(both.catalog_id[star], wrong.catalog_id)


def test_frames_without_stars_hold_the_hot_pixels_alone():
    empty = TAN2018.replace({'star_tracker.limiting_magnitude': -2.0})
    frames = tracker_of(empty, 3, hot_pixels_per_frame=2, smear=True)
    assert frames.first.tolist() == [0, 2, 4, 6]
    assert not frames.catalog_id.any()


# What is refused

@pytest.mark.parametrize('values, message', [
    ({'truth.gyro.scale_factor_ppm': (1.0, 2.0)},
     'truth.gyro.scale_factor_ppm: got 2 values, needs 3'),
    ({'truth.gyro.scale_factor_ppm': (0.0, 0.0, 1e6)},
     'truth.gyro.scale_factor_ppm: got 1000000.0, allowed is -100000 to 100000 ppm'),
    ({'truth.gyro.misalignment_arcsec': (0.0, 0.0, 0.0, 0.0, 0.0, -3e4)},
     'truth.gyro.misalignment_arcsec: got -30000.0, allowed is -20000 to 20000 arcsec'),
    ({'truth.gyro.bias_random_walk_deg_h_sqrt_h': -1.0},
     'truth.gyro.bias_random_walk_deg_h_sqrt_h: got -1.0, allowed is 0 to 1e+06 deg/h/sqrt(h)'),
    ({'truth.gyro.arw_deg_sqrt_h': -1.0},
     'truth.gyro.arw_deg_sqrt_h: got -1.0, allowed is 0 to 100 deg/sqrt(h)'),
    ({'truth.star_tracker.centroid_sigma_px': -0.1},
     'truth.star_tracker.centroid_sigma_px: got -0.1, allowed is 0 to 100 px'),
    ({'truth.star_tracker.time_offset_s': 11.0},
     'truth.star_tracker.time_offset_s: got 11.0, allowed is -10 to 10 s'),
    ({'truth.star_tracker.smear': 1}, 'truth.star_tracker.smear: got 1 (int), needs a bool'),
    ({'truth.star_tracker.smear': True, 'motion.rate_deg_s': 30.0},
     'truth.star_tracker.smear: got trails of 5.4 deg (slew rate times exposure), '
     'allowed is 0 to 5 deg'),
    ({'simulation.images': True, 'motion.rate_deg_s': 30.0},
     'simulation.images: got trails of 5.4 deg (slew rate times exposure), '
     'allowed is 0 to 5 deg'),
    ({'truth.star_tracker.misidentified_fraction': 1.1},
     'truth.star_tracker.misidentified_fraction: got 1.1, allowed is 0 to 1'),
    ({'truth.star_tracker.hot_pixels_per_frame': 201},
     'truth.star_tracker.hot_pixels_per_frame: got 201, allowed is 0 to 200'),
    ({'truth.mounting_drift.sigma_arcsec': -1.0},
     'truth.mounting_drift.sigma_arcsec: got -1.0, allowed is 0 to 3600 arcsec'),
    ({'truth.mounting_drift.time_constant_s': 0.0},
     'truth.mounting_drift.time_constant_s: got 0.0, allowed is 10 to 1e+07 s'),
    ({'truth.observer.velocity': 'moon'},
     "truth.observer.velocity: got 'moon', allowed are 'barycentre', 'geocentre', 'orbit'"),
    ({'truth.observer.epoch_utc': 'now'},
     "truth.observer.epoch_utc: got 'now', needs an ISO 8601 time such as 2026-07-02T12:00:00"),
])
def test_an_impossible_value_is_refused_by_name_and_range(values, message):
    with pytest.raises(ConfigError) as error:
        TAN2018.replace(values)
    assert str(error.value) == message


@pytest.mark.parametrize('magnitude, count', [(-2.0, 0), (-1.0, 1)])
def test_a_sky_without_two_stars_confuses_nobody(magnitude, count):
    with pytest.raises(ConfigError) as error:
        tracker_of(TAN2018.replace({'star_tracker.limiting_magnitude': magnitude}), 1,
                   misidentified_fraction=0.5)
    assert str(error.value) == ('truth.star_tracker.misidentified_fraction: got 0.5 with '
                                f'{count} stars in the whole sky, needs 2')


def test_errors_survive_the_parameter_file():
    wrong = TAN2018.replace(ALL_ERRORS)
    assert parameter_file.parse(parameter_file.dump(wrong), 'x') == wrong
