# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulated messages, a calibrator that is fed with them, and what is to come of it."""

from dataclasses import replace
from functools import cache

import numpy as np

from instruments import TAN2018
from starcal_ros.core import rotation
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.states import EPSILON, LENS, PHI, PSI
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

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


def altered(frames, **columns):
    """Return frames with whole columns replaced."""
    return replace(frames, **columns)


@cache
def simulated():
    """Return the run that most tests feed."""
    return Simulated(SCENARIO)


@cache
def all_at_once():
    """Return a calibrator that has had all its messages in one batch, and its results."""
    run = simulated()
    return calibrated(run.gyro, run.frames)
