# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How small an effect that the model lacks is found, and after how long.

A right run tells the sigma of each effect that `filter.hypotheses` thinks of. In half of all runs
one is found from the size on at which the statistic that it adds up to reaches its limit.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.reproduction.outcome import Outcome
from starcal_ros.simulation import sensors

RUNS = 1
TIMES_MIN = (1.0, 5.0, 15.0, 60.0, 120.0)


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the scenario once; more runs say the same."""
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(gyro.next(gyro.count))
    calibrator.add_frames(tracker.next(tracker.count))
    length_min = scenario.simulation.duration_s / 60.0
    times = [time for time in TIMES_MIN if time <= length_min] or [length_min]
    per_minute = 60.0 * scenario.star_tracker.rate_hz
    found: dict[tuple[str, str], list[float]] = {}
    for k, _ in enumerate(calibrator.process(), start=1):
        if k in {round(time * per_minute) for time in times}:
            for effect, sizes in calibrator.consistency.limits():
                for number, size in zip(effect.numbers, sizes):
                    found.setdefault((effect.name, number), []).append(size)
        if k % 200 == 0:
            on_progress(k / tracker.count)
    for effect, ages in calibrator.consistency.step_limits([60.0 * time for time in times]):
        for number, sizes in zip(effect.numbers, np.transpose(ages)):
            found[effect.name, number] = sizes.tolist()
    rows = tuple((name, number, *(size if np.isfinite(size) else '-' for size in sizes))
                 for (name, number), sizes in found.items())
    return Outcome(
        f'What is found of what the model lacks, {length_min:.3g} min',
        ('effect', 'number', *(f'{time:.3g} min' for time in times)), rows,
        ('Sizes that are found in half of all runs: after that time from the beginning of the '
         'run; of a step after that time from the step on, in a run that has been calibrated '
         'for most of its length.',
         'It counts, besides, only what shifts a state by more than half of its sigma.'))
