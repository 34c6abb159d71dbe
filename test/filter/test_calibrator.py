# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages in any order, broken in any way: the same estimates, or counted and said."""

from dataclasses import asdict, replace
import time

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import TAN2018
from starcal_ros.config.models import observer
from starcal_ros.core import rotation
from starcal_ros.core.units import DEG
from starcal_ros.filter import message_queue
from starcal_ros.filter.belief import Nominal
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.states import CALIBRATED, EPSILON, LENS, PHI, PSI
from starcal_ros.measurements import preintegration
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.measurements.star_directions import StarDirections
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places

# 30 s at rest, then 60 s of slew.
SCENARIO = TAN2018.replace({'simulation.duration_s': 90.0})
START_NS = Truth.from_scenario(SCENARIO).motion.start_ns
SECOND_NS = 10**9


class Simulated:
    """The messages of a scenario and the truth behind them."""

    def __init__(self, scenario):
        gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
        self.scenario, self.truth = scenario, Truth.from_scenario(scenario)
        self.gyro, self.frames = gyro.next(gyro.count), tracker.next(tracker.count)

    def C_gi(self, stamps_ns):
        """Return the true attitude."""
        return np.swapaxes(self.truth.motion.attitude(np.atleast_1d(stamps_ns)), -1, -2)

    def normalised_errors(self, frame):
        """Return the 16 errors after a frame, T18's states, in units of their sigmas."""
        estimate, truth = frame.belief.estimate, self.truth
        error = np.empty(16)
        error[PHI] = rotation.log(self.C_gi(frame.stamp_ns)[0].T @ estimate.C_gi)   # Eq. 7
        error[EPSILON] = estimate.bias - truth.bias
        error[PSI] = rotation.log(estimate.C_sg @ truth.C_sg.T)                     # Eq. 8
        error[LENS] = estimate.intrinsics - truth.intrinsics
        return error / frame.belief.sigma


@pytest.fixture(scope='module')
def run():
    """The run that most tests feed."""
    return Simulated(SCENARIO)


def without(gyro, *spans_s):
    """Return the samples outside (begin, end] of each span, in seconds from the start."""
    t = (gyro.stamp_ns - START_NS) * 1e-9
    keep = np.all([(t <= low + 1e-6) | (t > high + 1e-6) for low, high in spans_s], axis=0)
    return GyroSamples(gyro.stamp_ns[keep], gyro.rate[keep])


def feed(calibrator, gyro, frames):
    """Give a calibrator all messages at once; return its results."""
    calibrator.add_gyro(gyro)
    calibrator.add_frames(frames)
    return list(calibrator.process())


def calibrated(gyro, frames, scenario=SCENARIO):
    """Return a new calibrator that has had all messages, and its results."""
    calibrator = Calibrator(scenario)
    return calibrator, feed(calibrator, gyro, frames)


def assert_same(results, expected):
    """Check two series of results for the same numbers, to the last bit."""
    assert len(results) == len(expected)
    for a, b in zip(results, expected):
        assert a.stamp_ns == b.stamp_ns
        for part in ('C_gi', 'bias', 'C_sg', 'intrinsics'):
            np.testing.assert_array_equal(getattr(a.belief.nominal, part),
                                          getattr(b.belief.nominal, part))
        np.testing.assert_array_equal(a.belief.root, b.belief.root)
        for part in ('uv_raster', 'residual', 'chi2', 'accepted', 'catalog_id', 'nis'):
            np.testing.assert_array_equal(getattr(a, part), getattr(b, part))


def assert_finite(calibrator):
    """Check that nothing in a belief is NaN or infinite."""
    belief = calibrator.belief
    for part in (belief.nominal.C_gi, belief.nominal.bias, belief.nominal.C_sg,
                 belief.nominal.intrinsics, belief.root, belief.sigma, belief.error):
        assert np.isfinite(part).all()


def assert_right(run, frame, sigmas=4.0):
    """Check all 16 errors against their sigmas; 4 sigma: one in a thousand by chance."""
    assert np.abs(run.normalised_errors(frame)).max() < sigmas


# Order


@pytest.fixture(scope='module')
def at_once(run):
    """The results of all messages in one batch."""
    return calibrated(run.gyro, run.frames)


def test_all_messages_at_once_give_the_truth_within_their_sigmas(run, at_once):
    calibrator, results = at_once
    assert len(results) == 180
    assert_right(run, results[-1])
    assert calibrator.take_notices() == []
    expected = {'gyro': 9000, 'frames': 180, 'stars': int(run.frames.star_counts.sum()),
                'acquisitions': 1}
    counts = asdict(calibrator.counts)
    counts['stars'] += counts.pop('rejected_stars')         # by the gate: one in 10 000
    assert counts == {**dict.fromkeys(counts, 0), **expected}


@pytest.mark.parametrize('seed', range(4))
def test_results_do_not_depend_on_how_messages_are_cut_and_interleaved(run, at_once, seed):
    """One topic may be ahead of the other by any time."""
    rng, calibrator, results = np.random.default_rng(seed), Calibrator(SCENARIO), []
    gyro, frames = run.gyro, run.frames
    while len(gyro) or len(frames):
        if rng.random() < 0.5:
            n = int(rng.integers(0, 1500))
            calibrator.add_gyro(gyro[:n])
            gyro = gyro[n:]
        else:
            n = int(rng.integers(0, 30))
            calibrator.add_frames(frames[:n])
            frames = frames[n:]
        if rng.random() < 0.7:
            results += calibrator.process()
    results += calibrator.process()
    assert_same(results, at_once[1])
    assert asdict(calibrator.counts) == asdict(at_once[0].counts)


@pytest.fixture(scope='module')
def long_silence():
    """A bias of 50 deg/h, two minutes with stars, 20 without, ten seconds with."""
    run = Simulated(TAN2018.replace({
        'simulation.duration_s': 1330.0, 'gyro.rate_hz': 20.0,
        'truth.gyro.bias_deg_h': (50.0, -50.0, 50.0),
        'estimator.initial_sigma.gyro_bias_deg_h': 100.0}))
    seen = (run.frames.stamp_ns - START_NS) * 1e-9
    run.frames = run.frames.take((seen <= 120.0) | (seen > 1320.0))
    return run


def test_bias_far_from_the_nominal_one_turns_nothing_while_no_star_is_seen(long_silence):
    """To first order about the nominal bias the attitude would be off by 3000 arcsec."""
    run = long_silence
    calibrator, results = calibrated(run.gyro, run.frames, run.scenario)
    assert calibrator.counts.acquisitions == 1
    back = next(result for result in results if result.stamp_ns > START_NS + 1320 * SECOND_NS)
    assert back.accepted.all() and back.nis < 2.0 * back.accepted.sum() + 5.0 * np.sqrt(
        4.0 * back.accepted.sum())
    assert_right(run, results[-1])


@pytest.mark.parametrize('size', [7, 2000])
def test_intervals_composed_afresh_do_not_depend_on_how_messages_are_cut(long_silence, size):
    run = long_silence
    calibrator, results = Calibrator(run.scenario), []
    calibrator.add_frames(run.frames)
    for low in range(0, len(run.gyro), size):
        calibrator.add_gyro(run.gyro[low:low + size])
        results += calibrator.process()
    assert_same(results, calibrated(run.gyro, run.frames, run.scenario)[1])


@pytest.mark.parametrize('frames_first', [True, False])
def test_results_of_one_message_at_a_time_are_those_of_all_at_once(run, at_once, frames_first):
    calibrator, results, k = Calibrator(SCENARIO), [], 0
    for i, stamp_ns in enumerate(run.gyro.stamp_ns):
        if not frames_first:
            calibrator.add_gyro(run.gyro[i:i + 1])
        while k < len(run.frames) and run.frames.stamp_ns[k] <= stamp_ns:
            calibrator.add_frames(run.frames[k:k + 1])
            k += 1
        if frames_first:
            calibrator.add_gyro(run.gyro[i:i + 1])
        results += calibrator.process()
    assert_same(results, at_once[1])


def test_frames_wait_while_the_gyro_is_silent_and_are_then_used(run, at_once):
    calibrator = Calibrator(SCENARIO)
    calibrator.add_frames(run.frames)
    assert list(calibrator.process()) == [] and calibrator.waiting == 180
    calibrator.add_gyro(run.gyro[:4000])                        # until 40 s, a frame's stamp
    results = list(calibrator.process())
    assert (len(results), calibrator.waiting) == (81, 99)
    assert list(calibrator.process()) == [] and calibrator.waiting == 99
    calibrator.add_gyro(run.gyro[4000:])
    assert_same([*results, *calibrator.process()], at_once[1])
    assert calibrator.waiting == 0


def test_frames_between_gyro_samples_are_used_at_their_own_stamps():
    """At 97.31 Hz none falls on a sample, 18 arcsec of slew apart at 0.5 deg/s."""
    run = Simulated(SCENARIO.replace({'gyro.rate_hz': 97.31}))
    assert not np.isin(run.frames.stamp_ns, run.gyro.stamp_ns).any()
    calibrator, results = calibrated(run.gyro, run.frames, run.scenario)
    assert_right(run, results[-1])
    assert calibrator.counts.gyro_gaps == 0


# What can not be used


def test_belief_holds_the_reading_that_covers_its_frame_from_the_first_fix_on(run):
    """While g turns; a time offset needs it. A reading covers the time up to its stamp."""
    _, results = calibrated(run.gyro[3900:4600], run.frames[80:90])
    rows = np.searchsorted(run.gyro.stamp_ns, [result.stamp_ns for result in results])
    assert len(results) == 10
    np.testing.assert_array_equal([result.belief.nominal.reading for result in results],
                                  run.gyro.rate[rows])


def altered(frames, **columns):
    """Return frames with whole columns replaced."""
    return replace(frames, **columns)


def test_duplicate_late_and_backward_gyro_samples_are_dropped_and_counted(run, at_once):
    gyro = run.gyro
    rows = np.arange(len(gyro))
    # sample 100 twice, 200 after 210, and a jump back over 50 samples that are sent again
    order = np.concatenate((rows[:101], rows[100:200], rows[201:211], [200], rows[211:500],
                            rows[450:500], rows[500:]))
    calibrator, results = calibrated(GyroSamples(gyro.stamp_ns[order], gyro.rate[order]),
                                     run.frames)
    counts = calibrator.counts
    assert (counts.dropped_messages, counts.gyro) == (1 + 1 + 50, len(gyro) - 1)
    assert (counts.gyro_gaps, counts.missing_gyro) == (1, 1)    # where 200 should have been
    notices = calibrator.take_notices()
    assert len([text for text in notices if 'not newer' in text]) == 1
    assert str(gyro.stamp_ns[100]) in notices[0]
    assert_right(run, results[-1])
    assert calibrator.take_notices() == []


def test_duplicate_and_backward_frames_are_dropped_and_counted(run, at_once):
    frames, calibrator = run.frames, Calibrator(SCENARIO)
    mixed = Frames.concatenate((frames[:20], frames[19:20], frames[5:15], frames[20:]))
    results = feed(calibrator, run.gyro, mixed)
    assert_same(results, at_once[1])
    assert calibrator.counts.dropped_messages == 11
    notices = calibrator.take_notices()
    assert len(notices) == 1 and str(frames.stamp_ns[19]) in notices[0]


@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf, 36.0, -1e6, 1e160, 1e308])
def test_gyro_samples_that_no_gyro_gives_are_dropped_and_counted(run, value):
    rate = run.gyro.rate.copy()
    rate[[1000, 3000], [0, 2]] = value
    calibrator, results = calibrated(GyroSamples(run.gyro.stamp_ns, rate), run.frames)
    counts = calibrator.counts
    assert (counts.dropped_messages, counts.gyro_gaps, counts.missing_gyro) == (2, 2, 2)
    notices = [text for text in calibrator.take_notices() if 'largest_rate_deg_s' in text]
    assert len(notices) == 1 and str(run.gyro.stamp_ns[1000]) in notices[0]
    assert_right(run, results[-1])


def test_spike_within_the_range_of_the_gyro_costs_the_attitude_for_a_while(run):
    rate = run.gyro.rate.copy()
    rate[3000, 1] = 34.0
    calibrator, results = calibrated(GyroSamples(run.gyro.stamp_ns, rate), run.frames)
    assert calibrator.counts.acquisitions == 2
    assert_finite(calibrator)
    assert_right(run, results[-1])


@pytest.mark.parametrize('row', [0, 1, 60, 179])
@pytest.mark.parametrize('fault', ['nothing finite', 'no root'])
def test_frame_that_would_poison_the_belief_is_set_aside(run, monkeypatch, row, fault):
    calibrator, calls = Calibrator(SCENARIO), 0
    update = calibrator.filter.update

    def poisoned(belief, stars, **options):
        nonlocal calls
        calls += 'judged' in options
        if calls == row + 1 and 'judged' in options:
            calls += 1
            if fault == 'no root':
                raise np.linalg.LinAlgError
            stars = stars._replace(uv=stars.uv * np.nan)
            return update(belief, stars, **{**options, 'gated': False})
        return update(belief, stars, **options)

    monkeypatch.setattr(calibrator.filter, 'update', poisoned)
    results = feed(calibrator, run.gyro, run.frames)
    assert len(results) >= 179
    assert all(result.belief.is_finite for result in results)
    said = [text for text in calibrator.take_notices() if 'nothing finite' in text]
    assert len(said) == 180 - len(results)
    assert all(np.isfinite([each.value for each in calibrator.consistency.statistics()]))
    assert_right(run, results[-1])


def test_calibration_goes_on_after_an_error_that_ended_it(run):
    """What waits is lost, all that was believed is not."""
    calibrator = Calibrator(SCENARIO)
    before = feed(calibrator, run.gyro[:5000], run.frames[:120])[-1]
    waiting = calibrator.waiting
    calibrator.resume()
    assert (calibrator.waiting, calibrator.counts.dropped_messages) == (0, waiting)
    after = feed(calibrator, run.gyro[5000:], run.frames[120:])
    assert calibrator.counts.frames == len(after) + 101
    assert (after[-1].belief.sigma[3:] <= before.belief.sigma[3:]).all()
    assert_right(run, after[-1])


@pytest.mark.parametrize('column, value, notice', [
    ('uv_raster', np.nan, 'u, v'), ('uv_raster', np.inf, 'u, v'),
    ('sigma', np.nan, 'sigma'), ('sigma', np.inf, 'sigma'), ('sigma', -0.05, 'sigma'),
    ('catalog_id', 0, 'catalog_id 0'), ('catalog_id', 999_999_999, '999999999'),
    ('catalog_id', -7, '-7')])
def test_star_that_can_not_be_used_is_left_out_counted_and_named_once(run, column, value, notice):
    """The estimates are those of a message without it."""
    values = getattr(run.frames, column).copy()
    rows = run.frames.first[[0, 50, 51]] + 2                # one star in three frames
    values[rows] = value
    calibrator, results = calibrated(run.gyro, altered(run.frames, **{column: values}))
    keep = np.ones(len(run.frames.sigma), dtype=bool)
    keep[rows] = False
    frames = run.frames
    first = frames.first - np.searchsorted(rows, frames.first)
    _, expected = calibrated(run.gyro, Frames(
        frames.stamp_ns, first, *(part[keep] for part in (
            frames.uv_raster, frames.sigma, frames.magnitude, frames.catalog_id))))
    assert (calibrator.counts.unusable_stars, calibrator.counts.rejected_stars) == (3, 0)
    # another order of summation: rounding, in units of the sigmas
    difference = results[-1].belief.nominal.minus(expected[-1].belief.nominal)
    np.testing.assert_allclose(difference / expected[-1].belief.sigma, 0.0, atol=1e-6)
    notices = calibrator.take_notices()
    assert len(notices) == 1 and notice in notices[0]
    assert calibrator.take_notices() == []
    assert not results[50].accepted[2]


def test_star_without_a_sigma_has_that_of_the_scenario(run, at_once):
    zero = altered(run.frames, sigma=np.zeros(len(run.frames.sigma)))
    assert_same(calibrated(run.gyro, zero)[1], at_once[1])


def test_star_without_magnitude_is_as_good_as_others(run, at_once):
    dark = altered(run.frames, magnitude=np.full(len(run.frames.magnitude), np.nan))
    assert_same(calibrated(run.gyro, dark)[1], at_once[1])


def test_empty_frames_are_counted_and_change_no_calibration(run):
    """Frames 0 to 9 and 60 to 69 without stars: later beginning, and ten steps of gyro alone."""
    counts = run.frames.star_counts.copy()
    empty = np.r_[0:10, 60:70]
    counts[empty] = 0
    keep = np.repeat(~np.isin(np.arange(180), empty), run.frames.star_counts)
    frames = run.frames
    frames = Frames(frames.stamp_ns, np.concatenate(([0], np.cumsum(counts))), *(
        part[keep] for part in (frames.uv_raster, frames.sigma, frames.magnitude,
                                frames.catalog_id)))
    calibrator, results = calibrated(run.gyro, frames)
    assert (calibrator.counts.frames, calibrator.counts.empty_frames) == (180, 20)
    assert_finite(calibrator)
    assert_right(run, results[-1])
    before = next(r for r in results if r.stamp_ns == frames.stamp_ns[59])
    during = next(r for r in results if r.stamp_ns == frames.stamp_ns[65])
    np.testing.assert_array_equal(during.belief.nominal.intrinsics,
                                  before.belief.nominal.intrinsics)
    assert (during.belief.tracker_sigma >= before.belief.tracker_sigma * (1 - 1e-9)).all()


def test_frame_without_stars_speaks_neither_for_the_attitude_nor_against_it(run):
    """Nor do more of them in a row than wrong ones are borne."""
    stars = run.frames[:10]
    count = SCENARIO.estimator.reacquire_after_frames + 3
    first = np.append(stars.first, np.full(count, stars.first[-1]))
    calibrator, _ = calibrated(run.gyro[:1500], replace(
        stars, stamp_ns=run.frames.stamp_ns[:10 + count], first=first))
    assert calibrator.counts.empty_frames >= count - 1      # the last may wait for one more
    assert calibrator.tracking and calibrator.counts.acquisitions == 1


def test_noise_in_place_of_messages_raises_nothing_and_leaves_the_belief_finite(run):
    """Everything wrong at once, in random places."""
    rng, gyro, frames = np.random.default_rng(1), run.gyro, run.frames
    stamps, rate = gyro.stamp_ns.copy(), gyro.rate.copy()
    stamps[rng.integers(0, len(stamps), 50)] -= rng.integers(0, 10**12, 50)
    rate[rng.integers(0, len(rate), 50)] = np.nan
    uv, sigma, number = frames.uv_raster.copy(), frames.sigma.copy(), frames.catalog_id.copy()
    uv[rng.integers(0, len(uv), 200)] *= rng.choice([1e300, -1e9, np.nan, 0.0], (200, 1))
    sigma[rng.integers(0, len(sigma), 200)] = rng.choice([1e9, -1.0, np.nan, np.inf], 200)
    number[rng.integers(0, len(number), 400)] = rng.integers(-5, 200_000, 400)
    calibrator, results = calibrated(
        GyroSamples(stamps, rate), replace(frames, uv_raster=uv, sigma=sigma, catalog_id=number))
    assert len(results) > 100
    assert_finite(calibrator)
    assert all(np.isfinite(result.belief.root).all() for result in results)
    assert_right(run, results[-1])


@pytest.mark.parametrize('tiny', [1e-8, float(np.finfo(np.float32).tiny)])
def test_sigma_of_almost_nothing_raises_nothing(run, tiny):
    """Finite and positive, as a float32 on the topic can be."""
    sigma = run.frames.sigma.copy()
    sigma[::40] = tiny
    calibrator, _ = calibrated(run.gyro, altered(run.frames, sigma=sigma))
    assert_finite(calibrator)


@pytest.mark.parametrize('huge', [1e6, 1e20, 1e300])
def test_centroid_far_off_the_detector_raises_nothing(run, huge):
    uv = run.frames.uv_raster.copy()
    uv[::40] = huge
    calibrator, results = calibrated(run.gyro, altered(run.frames, uv_raster=uv))
    assert_finite(calibrator)
    assert_right(run, results[-1])


def test_nothing_at_all_raises_nothing():
    calibrator = Calibrator(SCENARIO)
    assert feed(calibrator, GyroSamples.empty(), Frames.empty()) == []
    assert len(calibrator.track().stamp_ns) == 0
    assert not calibrator.tracking


# Wrong stamps, and clocks that are set back


def stamped(gyro, rows, stamp_ns):
    """Return gyro samples of which some have another stamp."""
    stamps = gyro.stamp_ns.copy()
    stamps[rows] = stamp_ns
    return GyroSamples(stamps, gyro.rate)


@pytest.mark.parametrize('row', [0, 4000, 8999])
@pytest.mark.parametrize('stamp_ns', [START_NS + 120 * SECOND_NS, 2 * 10**18])
def test_one_wrong_stamp_of_the_gyro_costs_that_reading(run, row, stamp_ns):
    calibrator, results = calibrated(stamped(run.gyro, row, stamp_ns), run.frames)
    rest = [part for part in (run.gyro[:row], run.gyro[row + 1:]) if len(part)]
    expected, expected_results = calibrated(GyroSamples.concatenate(rest), run.frames)
    assert_same(results, expected_results)
    assert calibrator.counts == replace(expected.counts, dropped_messages=int(row < 8999))
    assert calibrator.counts.restarts == 0


@pytest.mark.parametrize('row', [0, 100, 179])
@pytest.mark.parametrize('stamp_ns', [START_NS + 120 * SECOND_NS, 2 * 10**18])
def test_one_wrong_stamp_of_a_frame_costs_that_frame(run, row, stamp_ns):
    stamps = run.frames.stamp_ns.copy()
    stamps[row] = stamp_ns
    calibrator, results = calibrated(run.gyro, replace(run.frames, stamp_ns=stamps))
    _, expected = calibrated(run.gyro, Frames.concatenate((run.frames[:row],
                                                           run.frames[row + 1:])))
    assert_same(results, expected)
    assert (calibrator.counts.dropped_messages, calibrator.counts.restarts) == (int(row < 179), 0)


def again(run, count):
    """Return all messages, several times."""
    return GyroSamples.concatenate([run.gyro] * count), Frames.concatenate([run.frames] * count)


def test_recording_that_is_played_again_starts_the_estimates_again(run, at_once):
    calibrator, results = calibrated(*again(run, 3))
    assert len(results) == 3 * 180
    for low in range(0, 540, 180):
        assert_same(results[low:low + 180], at_once[1])
    assert calibrator.counts == replace(at_once[0].counts, restarts=2)
    notices = calibrator.take_notices()
    assert len(notices) == 2
    assert f'went back by 89.990 s to {run.gyro.stamp_ns[0]} ns' in notices[0]


@pytest.mark.parametrize('seed', range(2))
def test_restarts_do_not_depend_on_how_messages_are_cut_and_interleaved(run, at_once, seed):
    rng, calibrator, results = np.random.default_rng(seed), Calibrator(SCENARIO), []
    gyro, frames = again(run, 2)
    while len(gyro) or len(frames):
        if rng.random() < 0.5:
            n = int(rng.integers(0, 1500))
            calibrator.add_gyro(gyro[:n])
            gyro = gyro[n:]
        else:
            n = int(rng.integers(0, 30))
            calibrator.add_frames(frames[:n])
            frames = frames[n:]
        results += calibrator.process()
    assert_same(results, at_once[1] * 2)
    assert calibrator.counts == replace(at_once[0].counts, restarts=1)


def test_clock_that_is_set_back_before_its_time_starts_the_estimates_again(run, at_once):
    """The player is started anew after 60 s, and then passes these."""
    gyro = GyroSamples.concatenate((run.gyro[:6000], run.gyro))
    calibrator, results = calibrated(gyro, Frames.concatenate((run.frames[:119], run.frames)))
    assert_same(results[:119], at_once[1][:119])
    assert_same(results[119:], at_once[1])
    assert calibrator.counts.restarts == 1


def test_frames_that_still_wait_when_the_clock_is_set_back_are_dropped_and_counted(run, at_once):
    """The gyro ends at 58 s, the frames at 59.5 s; then the clocks of both go back."""
    gyro = GyroSamples.concatenate((run.gyro[:5800], run.gyro))
    calibrator, results = calibrated(gyro, Frames.concatenate((run.frames[:120], run.frames)))
    assert_same(results[-180:], at_once[1])
    assert calibrator.counts.restarts == 1
    assert calibrator.counts.dropped_messages == 300 - len(results) == 3


@pytest.mark.parametrize('topic', ['gyro', 'frames'])
def test_clock_of_one_topic_that_is_wrong_for_a_while_costs_that_while(run, topic):
    """Its computer starts again, in 1970 until it has the time; the other goes on."""
    gyro, stamps = run.gyro, run.frames.stamp_ns.copy()
    if topic == 'gyro':
        rows = slice(3000, 4000)
        gyro = stamped(gyro, rows, gyro.stamp_ns[rows] - START_NS)
        expected = calibrated(without(run.gyro, (30.0, 40.0)), run.frames)[1]
    else:
        stamps[60:80] -= START_NS
        expected = calibrated(run.gyro, Frames.concatenate((run.frames[:60], run.frames[80:])))[1]
    frames, calibrator, results = replace(run.frames, stamp_ns=stamps), Calibrator(SCENARIO), []
    for k in range(9):
        calibrator.add_gyro(gyro[1000 * k:1000 * (k + 1)])
        calibrator.add_frames(frames[20 * k:20 * (k + 1)])
        results += calibrator.process()
    assert_same(results, expected)
    assert calibrator.counts.restarts == 0
    assert calibrator.counts.dropped_messages == (1000 if topic == 'gyro' else 20)


# Missing messages


@pytest.mark.parametrize('size', [1, 30, 180], ids=lambda size: f'{size} at a time')
def test_missing_messages_are_counted_from_the_stamps(run, size):
    keep = ~np.isin(np.arange(180), [7, 100, 101, 102])
    frames = Frames.concatenate([run.frames[k:k + 1] for k in np.flatnonzero(keep)])
    gyro = without(run.gyro, (20.0, 20.03), (70.0, 70.07))
    calibrator = Calibrator(SCENARIO)
    for k in range(0, 180, size):
        feed(calibrator, gyro[50 * k:50 * (k + size)], frames[k:k + size])
    counts = calibrator.counts
    assert (counts.missing_frames, counts.gyro_gaps, counts.missing_gyro) == (4, 2, 10)
    assert counts.dropped_messages == 0


@pytest.mark.parametrize('step_ns, gaps', [(15_000_000, 0), (15_000_001, 1)])
def test_more_than_one_and_a_half_intervals_are_a_silence(run, step_ns, gaps):
    stamps = run.gyro.stamp_ns[:200].copy()
    stamps[100:] += step_ns - 10**7
    calibrator, _ = calibrated(GyroSamples(stamps, run.gyro.rate[:200]), run.frames[:3])
    assert (calibrator.counts.gyro, calibrator.counts.gyro_gaps) == (200, gaps)


@pytest.mark.parametrize('low, high', [(10.0, 11.0), (50.0, 51.0), (15.0, 25.0), (45.0, 55.0)],
                         ids=['1 s at rest', '1 s of slew', '10 s at rest', '10 s of slew'])
def test_silence_of_the_gyro_is_bridged_counted_and_said(run, at_once, low, high):
    calibrator, results = calibrated(without(run.gyro, (low, high)), run.frames)
    counts = calibrator.counts
    assert (counts.gyro_gaps, counts.missing_gyro) == (1, round(100 * (high - low)))
    text, = [text for text in calibrator.take_notices() if 'silent' in text]
    assert f'{high - low + 0.01:.3f} s' in text
    assert_finite(calibrator)
    assert len(results) == 180
    for result in results[round(2 * low)::10]:
        assert_right(run, result)


@pytest.mark.parametrize('length', [0.2, 1.0, 10.0])
def test_attitude_is_less_certain_after_a_silence_by_what_may_hide_in_it(run, length):
    """1 deg/s^2 for the silence: t^2 / 2 deg, until the next sample ends it."""
    low = 40.1
    calibrator = Calibrator(SCENARIO)
    silent = without(run.gyro, (low, low + length))
    until = START_NS + round((low + length) * 1e9) + 10**7     # the first sample after it
    # and one more, with which the leap of the stamps is believed
    feed(calibrator, silent[:np.searchsorted(silent.stamp_ns, until) + 2], run.frames[:81])
    before = calibrator.belief.sigma[PHI]
    track = calibrator.track()
    after = np.sqrt(np.diagonal(track.covariance[-2]))
    hidden = 0.5 * length**2 * DEG
    # added to what was known before and to the random walk, arcseconds
    assert (after > hidden).all()
    np.testing.assert_allclose(after, np.hypot(before, hidden), rtol=1e-2)


# A lost attitude


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


# The integrated attitude


def tracked(run, size, frames_ahead=True):
    """Feed samples in batches, as a node does; return the joined track."""
    calibrator, tracks, k = Calibrator(SCENARIO), [], 0

    def process():
        tracks.extend(result.track for result in calibrator.process(tracked=True))
        tracks.append(calibrator.track())

    for low in range(0, len(run.gyro), size):
        batch = run.gyro[low:low + size]
        to = int(np.searchsorted(run.frames.stamp_ns, batch.stamp_ns[-1], side='right'))
        if frames_ahead:
            calibrator.add_frames(run.frames[k:to])
        calibrator.add_gyro(batch)
        if not frames_ahead:
            process()
            calibrator.add_frames(run.frames[k:to])
        process()
        k = to
    return [np.concatenate(parts) for parts in zip(*tracks)]


def assert_tracks(run, stamps, C_gi, covariance, rate):
    """Check a track against the truth, 4 sigma on each axis, and its rate."""
    phi = rotation.log(run.truth.motion.attitude(stamps) @ C_gi)            # Eq. 7
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    settled = stamps > START_NS + 20 * SECOND_NS
    assert (np.abs(phi) < 4.0 * sigma)[settled].all()
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    # white noise of N / sqrt(dt); 5 sigma for 27 000 draws; the bias is known to 0.1 deg/h
    noise = 0.001 * DEG / 60.0 / np.sqrt(0.01)
    C_ig = run.truth.motion.attitude(np.concatenate(([stamps[0] - 10**7], stamps)))
    true_rate = rotation.log(np.swapaxes(C_ig[:-1], -1, -2) @ C_ig[1:]) / 0.01
    assert np.abs(rate - true_rate).max() < 5.0 * noise


def test_track_has_each_gyro_stamp_once_and_agrees_with_the_truth(run):
    """Frames arrive some time after the samples around them, as from a camera."""
    stamps, *rest = tracked(run, 10, frames_ahead=False)
    begun = run.gyro.stamp_ns[run.gyro.stamp_ns > stamps[0] - 1]
    np.testing.assert_array_equal(stamps, begun)
    assert stamps[0] <= START_NS + 11 * 10**7           # from the first frame, in the first batch
    assert_tracks(run, stamps, *rest)


@pytest.mark.parametrize('size', [1, 500])
def test_track_has_each_gyro_stamp_once_where_frames_are_processed_with_the_samples(run, size):
    """Those at a frame's stamp and between two frames of one batch are not left out."""
    stamps, *rest = tracked(run, size)
    np.testing.assert_array_equal(stamps, run.gyro.stamp_ns)
    assert_tracks(run, stamps, *rest)


def test_attitude_now_is_the_last_of_the_track(run):
    calibrator, _ = calibrated(run.gyro[:-30], run.frames)
    track = calibrator.track()
    stamp_ns, C_gi = calibrator.attitude_now()
    assert stamp_ns == track.stamp_ns[-1] == run.gyro.stamp_ns[-31]
    np.testing.assert_allclose(C_gi, track.C_gi[-1], rtol=0, atol=1e-15)


def test_track_takes_the_bias_off_the_rates(run):
    calibrator, _ = calibrated(run.gyro, run.frames)
    track = calibrator.track()
    np.testing.assert_array_equal(track.rate, run.gyro.rate[-len(track.rate):]
                                  - calibrator.belief.estimate.bias)


def test_rates_are_as_uncertain_as_a_reading_and_the_bias(run):
    """A reading scatters by N / sqrt(dt), 0.001 deg/sqrt(h) at 100 Hz, each axis by itself."""
    noise = np.eye(3) * (0.001 * DEG / 60.0)**2 / 0.01
    np.testing.assert_allclose(Calibrator(SCENARIO).rate_covariance, noise, rtol=1e-12)
    calibrator, _ = calibrated(run.gyro[:500], run.frames[:10])
    bias = calibrator.belief.covariance[EPSILON, EPSILON]
    np.testing.assert_allclose(calibrator.rate_covariance, noise + bias, rtol=1e-9)
    assert (np.diag(bias) > 1e-6 * np.diag(noise)).all()


@pytest.mark.parametrize('walk', [0.0, 3000.0])
def test_track_is_as_uncertain_as_the_filter_would_be_at_its_end(run, walk):
    """29 s at rest after one frame, the bias known to 100 deg/h: 2900 arcsec, most of it all.

    A walk of the bias by 50 arcsec/s in the root of a second adds 50 * 29**1.5 / sqrt(3): 4500.
    """
    scenario = SCENARIO.replace({'estimator.initial_sigma.gyro_bias_deg_h': 100.0,
                                 'estimator.process_noise.gyro_bias_deg_h_sqrt_h': walk})
    one = run.frames[:1]            # believed when another, empty one follows
    frames = replace(one, stamp_ns=run.frames.stamp_ns[:2], first=one.first[[0, 1, 1]])
    calibrator, _ = calibrated(run.gyro[:2900], frames, scenario)
    track = calibrator.track()
    interval = preintegration.preintegrate(
        run.gyro[:2900], np.array([calibrator.stamp_ns, run.gyro.stamp_ns[2899]]),
        calibrator.filter.start.bias, 1e7)
    after = calibrator.filter.propagate(
        calibrator.belief, preintegration.Preintegrated(*(part[0] for part in interval)))
    np.testing.assert_allclose(track.C_gi[-1], after.estimate.C_gi, rtol=0, atol=1e-12)
    # at rest but for the drift of the attitude, 1e-4 rad
    sigma = after.sigma[PHI]
    assert (sigma > 2900.0 * DEG / 3600.0).all()
    np.testing.assert_allclose(track.covariance[-1] / np.outer(sigma, sigma),
                               after.covariance[PHI, PHI] / np.outer(sigma, sigma), atol=1e-3)


def test_track_without_new_samples_is_empty(run):
    calibrator, _ = calibrated(run.gyro, run.frames[:100])
    assert len(calibrator.track().stamp_ns) == 9000 - 4949      # from the frame at 49.5 s on
    assert len(calibrator.track().stamp_ns) == 0


def test_reprojection_error_is_that_of_the_centroids(run, at_once):
    """RMS of n centroids scatters by 1 / sqrt(2 n); the fit takes up a few of 4000."""
    n = at_once[0].counts.stars
    np.testing.assert_allclose(at_once[0].reprojection_rms_px, 0.05, rtol=4.0 / np.sqrt(2 * n))


# For hours


def test_gyro_without_frames_does_not_grow_without_bound():
    """Half a day of samples, an hour of them kept."""
    scenario = SCENARIO.replace({'gyro.rate_hz': 1.0, 'star_tracker.rate_hz': 0.01})
    calibrator = Calibrator(scenario)
    for hour in range(12):
        stamps = START_NS + (hour * 3600 + np.arange(3600)) * SECOND_NS
        calibrator.add_gyro(GyroSamples(stamps, np.zeros((3600, 3))))
        list(calibrator.process())
        assert held(calibrator) <= 2 * 3600 + 1
    assert calibrator.counts.gyro == 12 * 3600
    assert calibrator.counts.dropped_messages == 12 * 3600 - held(calibrator)
    assert sum('oldest gyro readings are dropped' in text
               for text in calibrator.take_notices()) == 1


def held(calibrator):
    """Return how many readings and frames a calibrator keeps."""
    return len(calibrator._queue.gyro) + calibrator.waiting


def test_frames_without_gyro_do_not_grow_without_bound(run):
    """Before the first reading, and after the last."""
    for gyro in (GyroSamples.empty(), run.gyro[:100]):
        calibrator = Calibrator(SCENARIO)
        calibrator.add_gyro(gyro)
        for k in range(5):
            n = 10_000
            stamps = START_NS + (k * n + np.arange(n)) * SECOND_NS // 2 + 10 * SECOND_NS
            calibrator.add_frames(Frames(stamps, np.zeros(n + 1, np.int64), np.empty((0, 2)),
                                         np.empty(0), np.empty(0), np.empty(0, np.int64)))
            list(calibrator.process())
        assert calibrator.waiting <= 20_000
        assert calibrator.counts.dropped_messages >= 30_000
        assert calibrator.take_notices()


def test_frames_that_the_gyro_has_reached_are_used_however_many(run, monkeypatch):
    """The bound, here of 9, is on those that wait alone."""
    monkeypatch.setattr(message_queue, 'FRAMES_KEPT', 9)
    calibrator, results = calibrated(run.gyro, run.frames)
    assert len(results) == 180 and calibrator.counts.dropped_messages == 0


def test_used_messages_are_forgotten(run, at_once):
    assert held(at_once[0]) <= 52           # samples since the last frame, and one before


def test_track_costs_no_more_when_no_frame_has_come_for_long(run):
    """The samples of one call, not all since the last frame: a tenth of an hour of them."""
    calibrator, _ = calibrated(run.gyro[:100], run.frames[:2])

    def cost(first, count):
        stamps = START_NS + np.arange(first, first + count) * 10**7
        calibrator.add_gyro(GyroSamples(stamps, np.zeros((count, 3))))
        calibrator.track()
        best = np.inf
        for k in range(5):
            calibrator.add_gyro(GyroSamples(stamps[-1:] + (k + 1) * 10**7, np.zeros((1, 3))))
            begin = time.perf_counter()
            assert len(calibrator.track().stamp_ns) == 1
            best = min(best, time.perf_counter() - begin)
        return best

    soon, late = cost(101, 100), cost(301, 36_000)
    assert late < 0.01 + 10.0 * soon        # a sample's own 10 ms


def test_apparent_places_are_those_of_the_frames_own_stamp(run):
    """Aberration turns by 1 deg a day: frames of a year later have other places."""
    year = SCENARIO.replace({'simulation.start_utc': '2027-01-02T12:00:00'})
    later = Simulated(year)
    stars = catalog.load_containing(later.frames.catalog_id[:5])
    rows = stars.rows(later.frames.catalog_id[:5])
    places = [apparent_places(stars, rows, run_.frames.stamp_ns[:1], [5],
                              observer(SCENARIO.observer)) for run_ in (run, later)]
    # half a year turns v/c = 1e-4 round: up to 2e-4 rad
    assert np.abs(places[0] - places[1]).max() > 5e-5
    _, results = calibrated(later.gyro, later.frames)
    assert_right(later, results[-1])


def test_star_without_a_place_has_no_residual(run):
    """Not the difference to some other place: NaN, as its chi-square."""
    number = run.frames.catalog_id.copy()
    number[[3, 30]] = 0, 999_999
    _, results = calibrated(run.gyro[:200], altered(run.frames, catalog_id=number)[:3])
    nothing = np.concatenate([np.isnan(result.residual).all(axis=1) for result in results])
    assert np.flatnonzero(nothing).tolist() == [3, 30]
    assert np.isnan(np.concatenate([result.chi2 for result in results])[nothing]).all()
