# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18's calibration from all the messages of a recording, and how it went.

The messages go through the same `Calibrator` as in the live estimator. Where noise levels are to
be estimated, passes before that find them (`noise_search`): better than what a single pass can do.
"""

from __future__ import annotations

from collections.abc import Callable

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.filter import message_pass, noise_search
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.history import History, HistoryKeeper
from starcal_ros.filter.noise import Noise
from starcal_ros.measurements.message_source import InMemory, MessageSource
from starcal_ros.measurements.samples import Frames, GyroSamples

_SOUGHT = 0.8           # part of the time in which noise levels are sought


def calibrate(gyro: GyroSamples, frames: Frames, scenario: Scenario,
              on_progress: Callable[[float], None] | None = None,
              covariance: Array | None = None) -> tuple[Calibrator, History]:
    """Calibrate from all the messages of a recording, which are in memory.

    Parameters
    ----------
    gyro, frames
        The messages, in the order in which they were recorded.
    scenario, on_progress, covariance
        As of `calibrate_source`.

    Returns
    -------
    calibrator : Calibrator
        After the last frame that the gyro reached.
    history : History
    """
    return calibrate_source(InMemory(gyro, frames), scenario, on_progress, covariance)


def calibrate_source(source: MessageSource, scenario: Scenario,
                     on_progress: Callable[[float], None] | None = None,
                     covariance: Array | None = None) -> tuple[Calibrator, History]:
    """Calibrate from all the messages of a run, however long it is.

    Parameters
    ----------
    source : MessageSource
        The messages.
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
            source, scenario, covariance, lambda part: told(sought * part)))
    calibrator = Calibrator(scenario, covariance, noise)
    keeper = HistoryKeeper(scenario)
    for results in message_pass.run(calibrator, source,
                                    lambda part: told(sought + (1.0 - sought) * part)):
        keeper.add(results)
    return calibrator, keeper.history(calibrator.noise.factor)
