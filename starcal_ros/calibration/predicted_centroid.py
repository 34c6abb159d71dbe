# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18: all 16 states from predicted star centroids, the gyro carrying the attitude.

The recording's messages go through the same `Stream` as in the live estimator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config import Scenario
from starcal_ros.estimator import N_STATES
from starcal_ros.measurements import Frames, GyroSamples
from starcal_ros.stream import Stream

Array = NDArray[np.float64]


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
        Camera, as in `starcal_ros.camera`.
    sigma : (n, 16) array
        Standard deviations, in the filter's units.
    """

    stamp_ns: NDArray[np.int64]
    bias: Array
    C_sg: Array
    intrinsics: Array
    sigma: Array


def calibrate(gyro: GyroSamples, frames: Frames, scenario: Scenario,
              on_progress: Callable[[float], None] | None = None) -> tuple[Stream, History]:
    """Calibrate from all the messages of a recording.

    Parameters
    ----------
    gyro, frames
        The messages, in the order in which they were recorded.
    scenario : Scenario
        Nominal values and estimator options.
    on_progress : callable, optional
        Called now and then with the part done, 0 to 1.

    Returns
    -------
    stream : Stream
        After the last frame that the gyro reached.
    history : History
    """
    stream = Stream(scenario)
    stream.add_gyro(gyro)
    stream.add_frames(frames)
    n = stream.waiting
    stamp_ns = np.empty(n, np.int64)
    bias, intrinsics, sigma = np.empty((n, 3)), np.empty((n, 7)), np.empty((n, N_STATES))
    C_sg = np.empty((n, 3, 3))
    rows = 0
    for rows, frame in enumerate(stream.process(), start=1):
        estimate, row = frame.belief.estimate, rows - 1
        stamp_ns[row], sigma[row] = frame.stamp_ns, frame.belief.sigma
        bias[row], C_sg[row], intrinsics[row] = estimate.bias, estimate.C_sg, estimate.intrinsics
        if on_progress and rows % 100 == 0:
            on_progress(rows / n)
    if on_progress:
        on_progress(1.0)
    return stream, History(stamp_ns[:rows], bias[:rows], C_sg[:rows], intrinsics[:rows],
                           sigma[:rows])
