# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The integrated attitude: each gyro stamp once, right, and as uncertain as it is said to be."""

from dataclasses import replace
import time

import numpy as np
import pytest

from starcal_ros.core import rotation
from starcal_ros.core.units import DEG
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.states import EPSILON, PHI
from starcal_ros.measurements import preintegration
from starcal_ros.measurements.samples import GyroSamples
from streams import SCENARIO, SECOND_NS, START_NS, calibrated


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
