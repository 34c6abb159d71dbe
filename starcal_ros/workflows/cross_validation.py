# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One recording in parts, each calibrated by itself: whether they find the same instrument.

What the parts know they have from data of their own; but all begin with the same nominal values
and initial sigmas. A state that a part hardly sees stays near them, in each part alike, so such
parts agree better than their sigmas let expect: `hardly_seen` names them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from starcal_ros.config.models import of_calibrated
from starcal_ros.config.scenario import Scenario
from starcal_ros.filter.offline import calibrate
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES, UNIT
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.results import result
from starcal_ros.results.document import CalibrationError
from starcal_ros.results.read import StoredResult, stored

LEAST_FRAMES = 40
"""Of a part."""
HARDLY = 0.5
"""Sigma of a part over the initial one from which a state is hardly seen."""


def calibrate_parts(gyro: GyroSamples, frames: Frames, scenario: Scenario, parts: int,
                    on_progress: Callable[[float], None] = lambda part: None
                    ) -> list[StoredResult]:
    """Calibrate from each of some parts of a recording, of like numbers of frames.

    Parameters
    ----------
    gyro, frames
        The messages, in the order in which they were recorded.
    scenario : Scenario
        Nominal values and estimator options.
    parts : int
        How many, two at least.
    on_progress : callable
        Called with the part done, 0 to 1.

    Raises
    ------
    CalibrationError
        Where a part has too few frames, or gives no attitude.
    """
    if len(frames) < parts * LEAST_FRAMES:
        raise CalibrationError(
            f'{len(frames)} frames in {parts} parts: each needs {LEAST_FRAMES} at least')
    cuts = np.linspace(0, len(frames), parts + 1).astype(int)
    found = []
    for k, (low, high) in enumerate(zip(cuts[:-1], cuts[1:])):
        first, last = frames.stamp_ns[low], frames.stamp_ns[high - 1]
        # The reading that is under way at a frame ends after it.
        end = last + round(2e9 / scenario.gyro.rate_hz)
        near = (gyro.stamp_ns >= first) & (gyro.stamp_ns <= end)
        calibrator, _ = calibrate(gyro.take(near), frames[low:high], scenario,
                                  lambda done: on_progress((k + done) / parts))
        found.append(stored(f'part {k + 1}', result.result(calibrator, {})))
    return found


def hardly_seen(results: Sequence[StoredResult], scenario: Scenario) -> Iterator[str]:
    """Yield for each part the states that its own data hardly tell, in words."""
    initial = of_calibrated(scenario.estimator.initial_sigma) * UNIT[CALIBRATED]
    for each in results:
        sigma = np.sqrt(np.diagonal(each.covariance))
        names = [name for name, part in zip(STATE_NAMES[CALIBRATED], sigma / initial)
                 if part > HARDLY]
        if names:
            yield (f'{each.name} hardly sees {", ".join(names)}: there all parts stay near the '
                   'nominal values, and agree by that')
