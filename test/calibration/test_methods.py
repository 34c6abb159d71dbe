# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What every calibration method must do: all files of `starcal_ros.calibration` are tried."""

from dataclasses import replace
from functools import cache
import re

import numpy as np
import pytest

from instruments import TAN2018, TOP
from starcal_ros import calibration
from starcal_ros.config import models
from starcal_ros.config.parameter import ConfigError
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.simulation import sensors

SLEWING = TAN2018.replace({'motion.dwell_s': 0.0, 'motion.rate_deg_s': 2.0,
                           'simulation.duration_s': 120.0, 'star_tracker.limiting_magnitude': 6.0})

NEEDS: dict[str, dict[str, object]] = {}
"""Parameters that a method needs beside, by its name: more motion, say."""

METHODS = pytest.mark.parametrize('method', calibration.names())


@cache
def recording(method):
    """Return scenario, truth, gyro and frames for a method."""
    scenario = SLEWING.replace({'intrinsics.method': method, **NEEDS.get(method, {})})
    tracker, gyro = sensors.star_tracker(scenario), sensors.gyro(scenario)
    return (scenario, tracker.truth.intrinsics, gyro.next(gyro.count),
            tracker.next(tracker.count))


def calibrated(scenario, gyro, frames, sizes):
    """Feed a method as a live node would, some frames at a time, and return all its estimates."""
    method = calibration.start(scenario)
    estimates, begin, taken = [], 0, 0
    for size in sizes:
        part = frames[begin:begin + size]
        begin += size
        reached = int(np.searchsorted(gyro.stamp_ns, part.stamp_ns.max(initial=0), 'right'))
        method.add_gyro(gyro[taken:reached + 1])
        method.add_frames(part)
        taken = max(taken, reached + 1)
        estimates.append(method.estimate())
    return method, [estimate for estimate in estimates if estimate is not None]


def spoilt(frames):
    """Return frames with all that comes from a star tracker now and then."""
    counts = frames.star_counts
    index = np.arange(len(frames.catalog_id)) - np.repeat(frames.first[:-1], counts)
    frame = np.repeat(np.arange(len(frames)), counts)
    keep = np.ones(len(index), bool)
    keep[frame % 10 == 3] = False                               # no star
    keep[(frame % 10 == 5) & (index != 0)] = False              # one star
    keep[(frame % 10 == 7) & (index > 1)] = False               # two stars
    uv, catalog_id = frames.uv_raster.copy(), frames.catalog_id.copy()
    uv[(frame % 10 == 1) & (index == 2)] = np.nan
    catalog_id[(frame % 10 == 1) & (index == 3)] = 0            # not identified
    uv[(frame % 10 == 1) & (index == 3)] += 100.0
    first = np.concatenate(([0], np.cumsum(np.bincount(frame[keep], minlength=len(frames)))))
    frames = replace(
        frames, first=first, uv_raster=uv[keep], catalog_id=catalog_id[keep],
        sigma=frames.sigma[keep], magnitude=frames.magnitude[keep])
    return Frames.concatenate((frames[:50], frames[48:50], frames[50:], frames[:1]))


def assert_true(estimate, truth):
    assert np.isfinite(estimate.intrinsics).all() and np.isfinite(estimate.covariance).all()
    assert (np.abs(estimate.intrinsics - truth) <= 4.0 * estimate.sigma).all()


@METHODS
def test_nothing_comes_of_nothing(method):
    scenario, *_ = recording(method)
    begun = calibration.start(scenario)
    begun.add_gyro(GyroSamples.empty())
    begun.add_frames(Frames.empty())
    assert begun.estimate() is None
    assert begun.take_notices() == []


@METHODS
def test_method_ends_at_the_truth_by_its_own_measure(method):
    scenario, truth, gyro, frames = recording(method)
    _, estimates = calibrated(scenario, gyro, frames, [len(frames)])
    assert_true(estimates[-1], truth)
    first = calibration.start(scenario)
    first.add_gyro(gyro)
    first.add_frames(frames[:20])
    assert (estimates[-1].sigma <= first.estimate().sigma).all()
    np.testing.assert_allclose(estimates[-1].covariance, estimates[-1].covariance.T)
    assert estimates[-1].frames <= len(frames) and estimates[-1].stars <= len(frames.catalog_id)


@METHODS
def test_result_is_the_same_whatever_the_batches(method):
    scenario, _, gyro, frames = recording(method)
    _, (whole,) = calibrated(scenario, gyro, frames, [len(frames)])
    sizes = [1, 1, 0, 7, 30, 2]
    sizes.append(len(frames) - sum(sizes))
    _, parts = calibrated(scenario, gyro, frames, sizes)
    assert (parts[-1].frames, parts[-1].stars) == (whole.frames, whole.stars)
    # Rounding alone may differ.
    np.testing.assert_allclose((parts[-1].intrinsics - whole.intrinsics) / whole.sigma, 0.0,
                               atol=1e-6)


@METHODS
def test_bad_frames_and_stars_do_no_harm(method):
    scenario, truth, gyro, frames = recording(method)
    frames = spoilt(frames)
    begun, estimates = calibrated(scenario, gyro, frames, [20] * (len(frames) // 20 + 1))
    for estimate in estimates:
        assert np.isfinite(estimate.intrinsics).all() and np.isfinite(estimate.covariance).all()
    assert_true(estimates[-1], truth)
    notices = begun.take_notices()
    assert any('not newer' in text for text in notices)
    assert any('needs a place on the detector' in text for text in notices)
    assert begun.take_notices() == []


@METHODS
def test_one_frame_stamped_a_day_ahead_costs_that_frame(method):
    scenario, _, gyro, frames = recording(method)
    stamps = frames.stamp_ns.copy()
    stamps[10] += 86_400 * 10**9
    begun, (estimate,) = calibrated(scenario, gyro, replace(frames, stamp_ns=stamps),
                                    [len(frames)])
    assert begun.stamp_ns == frames.stamp_ns[-1]
    _, (without,) = calibrated(scenario, gyro, frames.take(np.arange(len(frames)) != 10),
                               [len(frames)])
    assert (estimate.frames, estimate.stars) == (without.frames, without.stars)
    np.testing.assert_array_equal(estimate.intrinsics, without.intrinsics)
    assert [text for text in begun.take_notices() if 'frame at' in text] == [
        f'frame at {stamps[10]} ns is ahead of those that follow: dropped']


@METHODS
def test_the_stamp_of_an_estimate_is_that_of_a_frame_that_is_believed(method):
    scenario, _, gyro, frames = recording(method)
    ahead = replace(frames[60:61], stamp_ns=frames.stamp_ns[60:61] + 86_400 * 10**9)
    begun, _ = calibrated(scenario, gyro, Frames.concatenate((frames[:60], ahead)), [61])
    assert begun.stamp_ns == frames.stamp_ns[59]


@METHODS
def test_a_recording_that_is_played_again_tells_nothing_new(method):
    scenario, _, gyro, frames = recording(method)
    _, (once,) = calibrated(scenario, gyro, frames, [len(frames)])
    begun = calibration.start(scenario)
    begun.add_gyro(GyroSamples.concatenate((gyro, gyro)))
    begun.add_frames(Frames.concatenate((frames, frames)))
    twice = begun.estimate()
    assert (twice.frames, twice.stars) == (once.frames, once.stars)
    np.testing.assert_array_equal(twice.intrinsics, once.intrinsics)
    np.testing.assert_array_equal(twice.covariance, once.covariance)
    assert sum('started again' in text for text in begun.take_notices()) == 1


@METHODS
def test_frames_without_any_star_that_is_known_give_no_estimate(method):
    scenario, _, gyro, frames = recording(method)
    strange = replace(frames[:20], uv_raster=np.full_like(frames[:20].uv_raster, np.nan))
    _, estimates = calibrated(scenario, gyro, strange, [20])
    assert estimates == []


def test_example_of_the_documentation_ends_at_the_truth():
    page = TOP / 'docs' / 'howto' / 'add_method.md'
    example = re.search(r'```python\n(.*?)```', page.read_text(), re.DOTALL)
    module = {}
    exec(example[1], module)
    scenario, truth, _, frames = recording('angular_distance')
    method = module['start'](scenario)
    method.add_frames(frames)
    assert_true(method.estimate(), truth)
    assert (method.estimate().sigma < models.nominal_camera(scenario).sigma).all()


def test_unknown_method_is_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match="intrinsics.method: got 'x', allowed are .*angular"):
        calibration.start(TAN2018.replace({'intrinsics.method': 'x'}))
