# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The filter is consistent: NEES and NIS of runs whose truth is drawn from its own sigmas."""

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import TAN2018
from starcal_ros.config.scenario import from_flat
from starcal_ros.core import rotation
from starcal_ros.core.units import DEG_PER_HOUR
from starcal_ros.filter.belief import Nominal
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import THETA
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

pytestmark = pytest.mark.slow

FILTER = Filter(TAN2018)


class Run:
    """A calibrator of frames whose truth was drawn from the filter's own initial sigmas."""

    def __init__(self, seed, duration_s):
        rng = np.random.default_rng([20180314, seed])
        sigma = FILTER.initial_sigma.copy()
        sigma[THETA] = 0.0                      # the attitude is found from the stars
        drawn = FILTER.start.without(sigma * rng.normal(size=16))
        q_ig = rng.normal(size=4)
        values = TAN2018.flat()
        del values['truth.mounting.fixed_angles_deg']
        scenario = from_flat({
            **values, 'simulation.seed': seed, 'simulation.duration_s': duration_s,
            'motion.initial_quaternion_xyzw': tuple((q_ig / np.linalg.norm(q_ig)).tolist()),
            'truth.gyro.bias_deg_h': tuple((drawn.bias / DEG_PER_HOUR).tolist()),
            'truth.mounting.quaternion_xyzw': tuple(rotation.to_quaternion(drawn.C_sg).tolist()),
            'truth.camera.principal_point_px': tuple(drawn.intrinsics[:2].tolist()),
            'truth.camera.focal_length_mm': float(drawn.intrinsics[2]),
            'truth.camera.distortion': tuple(drawn.intrinsics[3:].tolist())})
        self.truth = Truth.from_scenario(scenario)
        gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
        self.calibrator = Calibrator(scenario)
        self.calibrator.add_gyro(gyro.next(gyro.count))
        self.calibrator.add_frames(tracker.next(tracker.count))
        self.frames = list(self.calibrator.process())

    def nees(self, k):
        """Return the NEES after a frame."""
        frame = self.frames[k]
        C_ig = self.truth.motion.attitude(np.array([frame.stamp_ns]))[0]
        return frame.belief.nees(Nominal(C_ig.T, self.truth.bias, self.truth.C_sg,
                                         self.truth.intrinsics))

    def nis(self):
        """Return the summed NIS and its degrees of freedom.

        Without the first frame, which its own attitude was found from, and those for which the
        linear model does not hold.
        """
        linear = [frame for frame in self.frames[1:] if frame.linear]
        return (sum(frame.nis for frame in linear),
                sum(2 * frame.accepted.sum() for frame in linear))


@pytest.fixture(scope='module')
def short_runs():
    """Many runs of 20 s, all of it the dwell before the first rotation."""
    return [Run(seed, 20.0) for seed in range(120)]


@pytest.fixture(scope='module')
def long_runs():
    """Thirty runs of 200 s: rotations about two of the gyro axes."""
    return [Run(1000 + seed, 200.0) for seed in range(30)]


def assert_mean_is_chi_square(values, degrees):
    """Check a mean of independent values against its 99.9 % chi-square interval."""
    n = len(values)
    low, high = chi2.ppf([0.0005, 0.9995], n * degrees) / n
    assert low < np.mean(values) < high


@pytest.mark.parametrize('frame', [0, 20, -1], ids=['first frame', 'after 10 s', 'end'])
def test_estimates_are_consistent_while_the_mounting_can_not_be_seen(short_runs, frame):
    """Here a filter that counts the attitude as phi, not theta, gets over-confident."""
    assert_mean_is_chi_square([run.nees(frame) for run in short_runs], 16)


@pytest.mark.parametrize('frame', [0, 20, 120, -1],
                         ids=['first frame', 'after 10 s', 'after 60 s', 'end'])
def test_estimates_are_consistent_through_rotations(long_runs, frame):
    assert_mean_is_chi_square([run.nees(frame) for run in long_runs], 16)


@pytest.mark.parametrize('runs', ['short_runs', 'long_runs'])
def test_innovations_are_consistent(runs, request):
    """The gate at 0.9999 takes a thousandth of the mean, a sixth of the narrower interval."""
    total, degrees = np.sum([run.nis() for run in request.getfixturevalue(runs)], axis=0)
    low, high = chi2.ppf([0.0005, 0.9995], degrees)
    assert low < total < high


def test_every_frame_of_the_drawn_runs_gave_a_result(short_runs, long_runs):
    assert {len(run.frames) for run in short_runs} == {40}
    assert {len(run.frames) for run in long_runs} == {400}
    assert {run.calibrator.counts.acquisitions for run in short_runs + long_runs} == {1}
