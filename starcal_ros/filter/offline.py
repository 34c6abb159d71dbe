# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18's calibration from all the messages of a recording, and how it went.

The messages go through the same `Calibrator` as in the live estimator. Where noise levels are to
be estimated, passes before that find them (`noise_search`): better than what a single pass can do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core import kalman
from starcal_ros.core.arrays import Array, Ints, Mask
from starcal_ros.filter import noise_search
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.noise import Noise
from starcal_ros.filter.states import N_STATES
from starcal_ros.filter.verdict import equivalent_sigma
from starcal_ros.measurements.intake import in_gyro_time
from starcal_ros.measurements.samples import Frames, GyroSamples

_SOUGHT = 0.8           # part of the time in which noise levels are sought


@dataclass(frozen=True)
class Residuals:
    """What the stars of all frames left over, one row a star, in the order of the frames.

    Attributes
    ----------
    uv_raster : (m, 2) array
        Measured centroids [px].
    residual : (m, 2) array
        Measured minus predicted centroid after the update [px]; NaN for an unusable star.
    accepted : (m,) bool array
        Stars used.
    sigma : (m,) array
        Standard deviation of the centroid, each axis, that the filter took [px].
    """

    uv_raster: Array
    residual: Array
    accepted: Mask
    sigma: Array


@dataclass(frozen=True)
class History:
    """How the estimates converged, one row a frame.

    Attributes
    ----------
    stamp_ns : (n,) int64 array
        Stamps of the frames.
    bias : (n, 3) array
        Gyro bias [rad/s].
    C_sg : (n, 3, 3) array
        Mounting.
    intrinsics : (n, 7) array
        Camera, as in `starcal_ros.core.camera`.
    sigma : (n, 16) array
        Standard deviations, in the filter's units.
    equivalent_sigma : (n, 2) array
        Standard deviation of the equivalent principal point, Eq. (V.1) of `verdict` [px].
    nis : (n,) array
        Normalised innovation squared of the stars used.
    used : (n,) int64 array
        Number of stars used; nis has twice as many degrees of freedom.
    stars : Residuals
    """

    stamp_ns: Ints
    bias: Array
    C_sg: Array
    intrinsics: Array
    sigma: Array
    equivalent_sigma: Array
    nis: Array
    used: Ints
    stars: Residuals


def calibrate(gyro: GyroSamples, frames: Frames, scenario: Scenario,
              on_progress: Callable[[float], None] | None = None,
              covariance: Array | None = None) -> tuple[Calibrator, History]:
    """Calibrate from all the messages of a recording.

    Parameters
    ----------
    gyro, frames
        The messages, in the order in which they were recorded.
    scenario : Scenario
        Nominal values and estimator options.
    on_progress : callable, optional
        Called now and then with the part done, 0 to 1.
    covariance : (13, 13) array, optional
        Of the error of the nominal values, in place of the initial sigmas.

    Returns
    -------
    calibrator : Calibrator
        After the last frame that the gyro reached.
    history : History
    """
    told = on_progress or (lambda part: None)
    noise, sought = None, 0.0
    if scenario.estimator.adapt:
        sought = _SOUGHT
        noise = Noise(scenario, noise_search.levels(
            gyro, frames, scenario, covariance, lambda part: told(sought * part)))
    calibrator = Calibrator(scenario, covariance, noise)
    calibrator.add_gyro(gyro)
    calibrator.add_frames(frames)
    n = calibrator.waiting
    stamp_ns, used = np.empty(n, np.int64), np.empty(n, np.int64)
    bias, C_sg, intrinsics = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 7))
    root = np.empty((n, N_STATES, N_STATES))
    nis = np.empty(n)
    uv_raster: list[Array] = [np.empty((0, 2))]
    residual: list[Array] = [np.empty((0, 2))]
    accepted: list[Mask] = [np.empty(0, bool)]
    rows = 0
    for row, frame in enumerate(calibrator.process()):
        estimate, rows = frame.belief.estimate, row + 1
        stamp_ns[row], nis[row] = frame.stamp_ns, frame.nis
        bias[row], C_sg[row], intrinsics[row] = estimate.bias, estimate.C_sg, estimate.intrinsics
        root[row] = frame.belief.state_root
        used[row] = frame.accepted.sum()
        uv_raster.append(frame.uv_raster)
        residual.append(frame.residual)
        accepted.append(frame.accepted)
        if rows % 100 == 0:
            told(sought + (1.0 - sought) * rows / n)
    told(1.0)
    done = slice(rows)
    return calibrator, History(
        stamp_ns[done], bias[done], C_sg[done], intrinsics[done], kalman.sigma_of(root[done]),
        equivalent_sigma(root[done], intrinsics[done], calibrator.filter.detector.pitch_mm),
        nis[done], used[done],
        Residuals(np.concatenate(uv_raster), np.concatenate(residual), np.concatenate(accepted),
                  _sigma(in_gyro_time(frames, scenario), stamp_ns[done], scenario)
                  * calibrator.noise.factor))


def _sigma(frames: Frames, stamp_ns: Ints, scenario: Scenario) -> Array:
    """Return the sigma of each star of the frames with these stamps."""
    # Of frames with the same stamp the first was used: the others are not newer.
    stamps, first = np.unique(frames.stamp_ns, return_index=True)
    row = first[np.searchsorted(stamps, stamp_ns)]
    sigma = np.concatenate([np.empty(0), *(
        frames.sigma[low:high] for low, high in zip(frames.first[row], frames.first[row + 1]))])
    return np.where(sigma == 0.0, scenario.star_tracker.centroid_sigma_px, sigma)
