# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A live stream of unidentified frames gets its catalogue numbers, whatever comes with it."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('tetra3rs')

from instruments import TAN2018  # noqa: E402
from starcal_ros.identification import frame_identifier  # noqa: E402
from starcal_ros.identification.frame_identifier import FrameIdentifier  # noqa: E402
from starcal_ros.measurements.samples import Frames, GyroSamples  # noqa: E402
from starcal_ros.simulation import sensors  # noqa: E402

# It turns from the second second on.
SCENARIO = TAN2018.replace({'simulation.duration_s': 40.0, 'motion.dwell_s': 2.0})
FRAMES, PERIOD_NS = 80, 500_000_000


@pytest.fixture(scope='module')
def readings():
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    return gyro.next(gyro.count), tracker.next(tracker.count)


def unidentified(frames):
    return replace(frames, catalog_id=np.zeros_like(frames.catalog_id))


def run(identifier, frames, wait=False):
    """Give frames, return the numbers of all that come back."""
    identifier.add_frames(unidentified(frames))
    return list(identifier.process(wait))


def assert_right(numbers, frames, most_missing=0.1):
    """Check numbers against those of the truth: none wrong, few missing."""
    assert len(numbers) == len(frames)
    found = np.concatenate(numbers)
    assert ((found == 0) | (found == frames.catalog_id)).all()
    assert (found == 0).mean() < most_missing


def test_frames_are_tracked_by_the_gyro_however_they_are_cut(readings):
    gyro, frames = readings
    whole, pieces = FrameIdentifier(SCENARIO), FrameIdentifier(SCENARIO)
    whole.add_gyro(gyro)
    at_once = run(whole, frames, wait=True)
    at_once += list(whole.process(False))       # the last reading is before the last frame
    assert_right(at_once, frames)
    counts = whole.take_counts()
    assert (counts['frames'], counts['frames found by a search']) == (FRAMES, 1)
    assert counts['spots'] == len(frames.catalog_id)
    assert counts['stars'] == np.count_nonzero(np.concatenate(at_once))
    assert not whole.take_counts() and not whole.take_notices()
    one_by_one = []
    for k in range(FRAMES):
        pieces.add_gyro(gyro[50 * k:50 * (k + 1)])
        one_by_one += run(pieces, frames[k:k + 1], wait=True)
    one_by_one += list(pieces.process(False))
    for one, other in zip(at_once, one_by_one, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_frame_waits_for_the_readings_up_to_its_stamp_and_holds_those_behind_it(readings):
    gyro, frames = readings
    identifier = FrameIdentifier(SCENARIO)
    assert run(identifier, frames[:4], wait=True) == []
    identifier.add_gyro(gyro[gyro.stamp_ns < frames.stamp_ns[2]])
    assert len(list(identifier.process(True))) == 2
    identifier.add_gyro(gyro[gyro.stamp_ns >= frames.stamp_ns[2]][:1])
    assert len(list(identifier.process(True))) == 1
    assert len(list(identifier.process(False))) == 1


def test_without_a_gyro_the_last_rate_goes_on(readings):
    identifier = FrameIdentifier(SCENARIO)
    assert_right(run(identifier, readings[1]), readings[1])
    assert identifier.take_counts()['frames found by a search'] <= 4     # at first, at the corners


def test_readings_that_are_late_twice_or_no_numbers_change_nothing(readings):
    gyro, frames = readings
    rate = gyro.rate.copy()
    rate[::100] = np.nan
    disturbed = GyroSamples(gyro.stamp_ns, rate)
    clean, identifier = FrameIdentifier(SCENARIO), FrameIdentifier(SCENARIO)
    clean.add_gyro(gyro.take(np.isfinite(rate[:, 0])))
    for k in range(0, len(gyro), 200):
        identifier.add_gyro(disturbed[k:k + 200])
        identifier.add_gyro(disturbed[max(k - 50, 0):k + 200])
    for one, other in zip(run(clean, frames), run(identifier, frames), strict=True):
        np.testing.assert_array_equal(one, other)


def test_readings_that_no_gyro_gives_are_counted_and_named_once(readings):
    gyro, frames = readings
    rate = gyro.rate.copy()
    rate[[100, 200], 1] = 1e6
    identifier = FrameIdentifier(SCENARIO)
    identifier.add_gyro(replace(gyro, rate=rate))
    assert_right(run(identifier, frames), frames)
    assert identifier.take_counts()['readings dropped'] == 2
    notice, = identifier.take_notices()
    assert 'gyro.largest_rate_deg_s' in notice


def test_a_clock_that_is_set_back_costs_a_search(readings):
    """The readings of a recording that is played in a loop, and its frames."""
    gyro, frames = readings
    identifier = FrameIdentifier(SCENARIO)
    identifier.add_gyro(gyro[:3000])
    numbers = run(identifier, frames[:40])
    identifier.add_gyro(GyroSamples.concatenate((gyro[3000:], gyro)))
    numbers += run(identifier, frames)
    assert_right(numbers, Frames.concatenate((frames[:40], frames)))
    assert identifier.take_counts()['frames found by a search'] == 2


def test_a_wrong_stamp_of_the_gyro_is_got_over(readings):
    gyro, frames = readings
    stamp_ns = gyro.stamp_ns.copy()
    stamp_ns[1000] += 3600 * 10**9
    identifier, numbers = FrameIdentifier(SCENARIO), []
    for k in range(FRAMES):
        identifier.add_gyro(GyroSamples(stamp_ns, gyro.rate)[50 * k:50 * (k + 1)])
        numbers += run(identifier, frames[k:k + 1])
    assert_right(numbers, frames)
    assert identifier.take_counts()['frames found by a search'] <= 3


def test_what_the_fields_of_a_frame_may_hold_is_borne(readings):
    """No sigma, no magnitude or any, places that are no numbers, nothing at all."""
    gyro, frames = readings
    frames = frames[:6]
    uv, magnitude, sigma = (value.copy() for value in (
        frames.uv_raster, frames.magnitude, frames.sigma))
    odd = np.arange(len(uv)) % 9
    uv[odd == 0], uv[odd == 1] = np.nan, 1e300
    magnitude[odd == 2], magnitude[odd == 3], magnitude[odd == 4] = np.inf, -np.inf, -1e4
    sigma[odd == 5], sigma[odd == 6] = np.nan, -1.0
    identifier = FrameIdentifier(SCENARIO)
    numbers = run(identifier, replace(frames, uv_raster=uv, magnitude=magnitude, sigma=sigma))
    assert_right(numbers, frames, 0.7)
    assert not np.concatenate(numbers)[np.isin(odd, [0, 1, 5, 6])].any()
    empty = Frames(frames.stamp_ns[:1] + 10**10, np.array([0, 0]), np.empty((0, 2)), np.empty(0),
                   np.empty(0), np.empty(0, np.int64))
    assert [len(number) for number in run(identifier, empty)] == [0]


def test_mirrored_stars_are_told_and_get_no_number(readings):
    frames = readings[1][:2]
    uv = frames.uv_raster * [-1.0, 1.0] + [SCENARIO.camera.width - 1.0, 0.0]
    identifier = FrameIdentifier(SCENARIO)
    numbers = run(identifier, replace(frames, uv_raster=uv))
    assert not np.concatenate(numbers).any()
    assert len(identifier.take_notices()) == 2 and not identifier.take_notices()


def test_readings_without_frames_do_not_fill_the_memory(readings, monkeypatch):
    monkeypatch.setattr(frame_identifier, 'GYRO_KEPT_NS', 5 * 10**9)
    gyro, frames = readings
    identifier = FrameIdentifier(SCENARIO)
    for k in range(len(gyro)):
        identifier.add_gyro(gyro[k:k + 1])
    assert len(identifier._gyro) <= 501
    assert_right(run(identifier, frames), frames)
