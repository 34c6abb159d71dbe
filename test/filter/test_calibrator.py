# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages in any order, broken in any way: the same estimates, or counted and said."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.config.models import observer
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import apparent_places
from streams import (SCENARIO, SECOND_NS, START_NS, Simulated, altered, assert_finite,
                     assert_right, assert_same, calibrated, feed)

# Order


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
    assert_same(one_at_a_time(run.gyro, run.frames, frames_first), at_once[1])


def one_at_a_time(gyro, frames, frames_first):
    """Return the results of messages in the order of their stamps."""
    calibrator, results, k = Calibrator(SCENARIO), [], 0
    for i, stamp_ns in enumerate(gyro.stamp_ns):
        if not frames_first:
            calibrator.add_gyro(gyro[i:i + 1])
        while k < len(frames) and frames.stamp_ns[k] <= stamp_ns:
            calibrator.add_frames(frames[k:k + 1])
            k += 1
        if frames_first:
            calibrator.add_gyro(gyro[i:i + 1])
        results += calibrator.process()
    return results


def test_results_of_one_message_at_a_time_are_the_same_where_the_gyro_begins_late(run):
    """As in a recording whose recorder found the gyro after the star tracker."""
    gyro, frames = run.gyro[117:1000], run.frames[:19]
    assert_same(one_at_a_time(gyro, frames, frames_first=True), calibrated(gyro, frames)[1])


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


def test_belief_holds_the_reading_that_covers_its_frame_from_the_first_fix_on(run):
    """While g turns; a time offset needs it. A reading covers the time up to its stamp."""
    _, results = calibrated(run.gyro[3900:4600], run.frames[80:90])
    rows = np.searchsorted(run.gyro.stamp_ns, [result.stamp_ns for result in results])
    assert len(results) == 10
    np.testing.assert_array_equal([result.belief.nominal.reading for result in results],
                                  run.gyro.rate[rows])


# What can not be used


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


def test_reprojection_error_is_that_of_the_centroids(run, at_once):
    """RMS of n centroids scatters by 1 / sqrt(2 n); the fit takes up a few of 4000."""
    n = at_once[0].counts.stars
    np.testing.assert_allclose(at_once[0].reprojection_rms_px, 0.05, rtol=4.0 / np.sqrt(2 * n))


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
