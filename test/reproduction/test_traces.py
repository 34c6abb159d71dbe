# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs over time: residuals of stars used and held out, the gyro alone, couplings."""

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import TAN2018
from starcal_ros.core.units import ARCSEC, DEG_PER_SQRT_HOUR
from starcal_ros.evaluation.batch_results import run_batch
from starcal_ros.reproduction import traces
from starcal_ros.reproduction.published.fig5 import bias_drift

pytestmark = pytest.mark.slow       # all of them need the runs

# A gyro so coarse that a frame must find its attitude by itself, from its own stars.
ARW, DURATION_S, RUNS = 1.0, 60.0, 40
SCENARIO = TAN2018.replace({'simulation.duration_s': DURATION_S, 'gyro.arw_deg_sqrt_h': ARW})


@pytest.fixture(scope='module')
def trace(tmp_path_factory):
    return traces.of(SCENARIO, RUNS, tmp_path_factory.mktemp('work'))


def mean_square(trace, held_out):
    """Return the mean square of the residuals over their variance, and its sigma."""
    which = trace.held_out == held_out
    ratio = trace.residual[which]**2 / trace.variance[which]
    return ratio.mean(), np.sqrt(2.0 / ratio.size)


@pytest.mark.parametrize('held_out', [False, True])
def test_residuals_have_the_variance_that_the_filter_states(trace, held_out):
    value, sigma = mean_square(trace, held_out)
    # 1e-3: what the gate of 0.9999 takes of the mean square
    assert value == pytest.approx(1.0, abs=1e-3 + 4.0 * sigma)


def test_stars_held_out_are_missed_by_more_than_those_used(trace):
    """Of 48 coordinates three are spent on the attitude: 1 - 3 / 48 against 1 + 3 / 38."""
    used, held_out = (np.mean(trace.residual[trace.held_out == part]**2)
                      for part in (False, True))
    stars = np.mean(np.bincount(np.searchsorted(trace.time, trace.stamp[~trace.held_out]))) / RUNS
    least = (1.0 + 3.0 / (2.0 * stars * (1.0 - 1.0 / traces.HELD_OUT))) / (1.0 - 1.5 / stars)
    # 0.98: three sigma of the 50 000 residuals; more: the calibration has only begun
    assert held_out / used > 0.98 * least


def test_one_star_in_five_is_held_out(trace):
    part = trace.held_out.mean() / (1.0 - trace.held_out.mean())
    assert part == pytest.approx(1.0 / traces.HELD_OUT, rel=0.05)


def test_gyro_alone_drifts_by_its_bias_and_walks_as_its_random_walk_says(trace):
    walked = trace.drift[:, -1] - bias_drift(SCENARIO, trace.time)
    walk = ARW * DEG_PER_SQRT_HOUR * np.sqrt(trace.time[-1] - trace.time[0])
    low, high = chi2.ppf([0.0005, 0.9995], 3 * RUNS)
    assert low < np.sum((walked / walk)**2) < high


def test_gyro_without_noise_drifts_by_its_bias_alone(tmp_path):
    """A minute at 0.01 deg/h is 0.6 arcsec along each axis; second order is 1e-3 of it."""
    quiet = SCENARIO.replace({'gyro.arw_deg_sqrt_h': 0.0})
    trace = traces.of(quiet, 1, tmp_path)
    expected = bias_drift(quiet, trace.time)
    assert np.linalg.norm(expected) / ARCSEC == pytest.approx(
        0.6 * np.sqrt(3.0) * 59.5 / 60.0, rel=0.02)
    np.testing.assert_allclose(trace.drift[0, -1], expected, atol=2e-3 * np.abs(expected).max())


def test_errors_are_those_of_the_monte_carlo(trace):
    runs = run_batch(SCENARIO, range(1, RUNS + 1))
    np.testing.assert_allclose(trace.error[:, -1], runs.error[:, -1], rtol=1e-12)
    np.testing.assert_allclose(trace.sigma[:, -1], runs.sigma[:, -1], rtol=1e-12)


def test_coupling_is_the_correlation():
    covariance = np.eye(16)
    covariance[9, 7] = covariance[7, 9] = 0.9           # u0 with Psi_y
    covariance[10, 6] = covariance[6, 10] = -0.8        # v0 with Psi_x
    scale = np.diag(np.arange(1.0, 17.0))
    np.testing.assert_allclose(traces.coupling(scale @ covariance @ scale), [0.9, -0.8])


def test_runs_are_kept_for_the_next_figure(tmp_path):
    short = SCENARIO.replace({'simulation.duration_s': 3.0})
    first = traces.of(short, 2, tmp_path)
    kept, = tmp_path.iterdir()
    when = kept.stat().st_mtime_ns
    second = traces.of(short, 2, tmp_path)
    assert kept.stat().st_mtime_ns == when
    np.testing.assert_array_equal(second.residual, first.residual)
    traces.of(short.replace({'star_tracker.centroid_sigma_px': 0.1}), 2, tmp_path)
    traces.of(short, 1, tmp_path)
    assert len(list(tmp_path.iterdir())) == 3
