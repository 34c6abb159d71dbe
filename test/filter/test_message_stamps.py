# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Wrong stamps, clocks that are set back, missing messages: counted, bridged and said."""

from dataclasses import replace

import numpy as np
import pytest

from starcal_ros.core.units import DEG
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.states import PHI
from starcal_ros.measurements.samples import Frames, GyroSamples
from streams import (SCENARIO, SECOND_NS, START_NS, assert_finite, assert_right, assert_same,
                     calibrated, feed, without)

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
