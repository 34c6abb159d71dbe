# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A history of a long run is one thinned, and batches change nothing of what a pass gives."""

from dataclasses import astuple, fields
import tracemalloc

import numpy as np

from instruments import TAN2018
from starcal_ros.core import rotation
from starcal_ros.core.units import ARCSEC
from starcal_ros.filter import history
from starcal_ros.filter.offline import calibrate, calibrate_source
from starcal_ros.measurements.message_source import InMemory, MessageBatch
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.simulation import sensors

RUN = TAN2018.replace({'simulation.duration_s': 120.0, 'gyro.rate_hz': 20.0,
                       'star_tracker.limiting_magnitude': 5.5})


class InPieces:
    """The messages of a scenario, some seconds at a time, made when they are asked for."""

    def __init__(self, scenario, seconds):
        self.scenario, self.seconds = scenario, seconds

    def batches(self):
        """Give all messages."""
        gyro, tracker = sensors.gyro(self.scenario), sensors.star_tracker(self.scenario)
        n = round(self.scenario.simulation.duration_s / self.seconds)
        for k in range(1, n + 1):
            yield MessageBatch(gyro.next(gyro.count * k // n - gyro.next_index),
                               tracker.next(tracker.count * k // n - tracker.next_index), k / n)


def in_memory(scenario):
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    return InMemory(gyro.next(gyro.count), tracker.next(tracker.count))


def test_batches_give_the_numbers_of_all_messages_at_once():
    told = []
    found, kept = calibrate_source(InPieces(RUN, 7.5), RUN, told.append)
    whole, expected = calibrate(*astuple_of(in_memory(RUN)), RUN)
    assert told == sorted(told) and told[-1] == 1.0 and len(told) == 16
    assert found.counts == whole.counts
    difference = found.belief.nominal.minus(whole.belief.nominal)
    # A part of the readings is integrated about another bias: a rounding.
    np.testing.assert_allclose(difference / whole.belief.sigma, 0.0, atol=1e-6)
    assert (kept.every, kept.frames) == (expected.every, expected.frames) == (1, 240)
    np.testing.assert_array_equal(kept.stamp_ns, expected.stamp_ns)
    np.testing.assert_array_equal(kept.used, expected.used)
    for field in fields(kept.stars):
        np.testing.assert_allclose(getattr(kept.stars, field.name),
                                   getattr(expected.stars, field.name), atol=1e-6)


def astuple_of(source):
    return source.gyro, source.frames


def test_a_run_that_is_played_again_has_the_rows_of_both():
    """In a recording of a replay in a loop, or of a simulation that was started twice."""
    short = RUN.replace({'simulation.duration_s': 20.0})
    gyro, frames = astuple_of(in_memory(short))
    _, once = calibrate(gyro, frames, short)
    again = calibrate(GyroSamples.concatenate([gyro] * 2), Frames.concatenate([frames] * 2),
                      short)
    assert again[0].counts.restarts == 1
    np.testing.assert_array_equal(again[1].stamp_ns, np.tile(once.stamp_ns, 2))
    np.testing.assert_array_equal(again[1].stars.sigma, np.tile(once.stars.sigma, 2))


def test_a_thinned_history_has_rows_of_the_whole_one(monkeypatch):
    source = in_memory(RUN)
    _, whole = calibrate_source(source, RUN)
    monkeypatch.setattr(history, 'MOST', 40)
    monkeypatch.setattr(history, '_BLOCK', 10)
    _, thin = calibrate_source(source, RUN)
    assert thin.every == 8 and thin.frames == len(whole.stamp_ns) == 240
    rows = np.append(np.arange(0, 240, 8), 239)         # and the last one
    for name in ('stamp_ns', 'bias', 'C_sg', 'intrinsics', 'sigma', 'equivalent_sigma', 'nis',
                 'used', 'turn', 'seen'):
        np.testing.assert_array_equal(getattr(thin, name), getattr(whole, name)[rows])
    np.testing.assert_array_equal(thin.turned, whole.turned)
    counts = np.diff(source.frames.first)
    kept = np.isin(np.repeat(np.arange(240), counts), rows)
    for part, every in zip(astuple(thin.stars), astuple(whole.stars)):
        np.testing.assert_array_equal(part, every[kept])


def test_turns_are_those_of_the_motion_and_whitened_ones_have_unit_variance():
    scenario = RUN.replace({'simulation.duration_s': 240.0})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    _, kept = calibrate(gyro.next(gyro.count), tracker.next(tracker.count), scenario)
    assert int(kept.seen.sum()) == len(kept.stars.catalog_id)
    C_ig = tracker.truth.motion.attitude(kept.stamp_ns)
    turned = np.abs(rotation.log(np.swapaxes(C_ig[1:], -1, -2) @ C_ig[:-1])).sum(axis=0)
    assert (turned > 0.2).all()
    # An attitude is good to some arc seconds from frame to frame.
    np.testing.assert_allclose(kept.turned, turned, atol=len(C_ig) * 10.0 * ARCSEC)
    turn = kept.turn[np.isfinite(kept.turn).all(axis=-1)]
    assert 300 < len(turn) < len(kept.turn)         # the first ones are not judged
    # Some thousand numbers: their mean square is 1 within 5 sigma.
    assert abs(np.mean(turn**2) - 1.0) < 5.0 * np.sqrt(2.0 / turn.size)


def test_a_long_run_takes_no_more_memory_than_a_short_one(monkeypatch):
    monkeypatch.setattr(history, 'MOST', 40)
    monkeypatch.setattr(history, '_BLOCK', 10)
    scenario = RUN.replace({'star_tracker.rate_hz': 1.0})
    peaks = []
    for seconds in (80.0, 80.0, 240.0):                 # the first one imports and caches
        run = scenario.replace({'simulation.duration_s': seconds})
        tracemalloc.start()
        kept = calibrate_source(InPieces(run, 10.0), run)[1]
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert kept.frames == seconds
    # Kept whole, 160 more frames would be 500 kB; a minute of statistics is 20 kB.
    assert peaks[2] < peaks[1] + 150_000, peaks
