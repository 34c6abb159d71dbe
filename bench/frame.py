# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the time of a frame goes: `python bench/frame.py`.

T18's scenario, two hours, through the calibrator: with the compiled arithmetic of
`filter.kernel`, which does most frames in one function (advance), and with that of
`filter.reference`; and the functions for themselves, over all frames. Processor time, so that what
else runs on the machine counts little.
"""

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
import time
from typing import Any

from bars import told

from starcal_ros.config import parameter_file
from starcal_ros.filter import arithmetic, kernel, reference
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.simulation import sensors

FUNCTIONS = ('advance', 'compose', 'propagate', 'bends', 'correct', 'carry', 'judge', 'tally',
             'fit')
MINUTES = 120.0
AIM_US = 90.0
_spent: dict[str, float] = defaultdict(float)


def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that notes how long it takes."""
    def run(*given: Any, **named: Any) -> Any:
        begin = time.process_time()
        found = function(*given, **named)
        _spent[name] += time.process_time() - begin
        return found
    return run


def main() -> None:
    """Measure both."""
    scenario = parameter_file.load(Path(__file__).parents[1] / 'config' / 'tan2018.yaml').replace(
        {'simulation.duration_s': 60.0 * MINUTES})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    whole = {}
    for part in (kernel, reference):
        _spent.clear()
        arithmetic.COMPILED = part.COMPILED
        for name in FUNCTIONS:
            setattr(arithmetic, name, timed(name, getattr(part, name)))
        calibrator = Calibrator(scenario)
        calibrator.add_gyro(samples)
        calibrator.add_frames(frames)
        begin = time.process_time()
        n = sum(1 for _ in calibrator.process())
        whole[part] = 1e6 * (time.process_time() - begin) / n
        name = part.__name__.rpartition('.')[-1]
        print(f'{name:<10} {whole[part]:7.0f} us a frame of {len(frames.sigma) / n:.0f} stars')
        for function in FUNCTIONS:
            print(f'    {function:<10} {1e6 * _spent[function] / n:7.0f} us')
    print(f'compiled   {whole[reference] / whole[kernel]:.1f} times as fast')
    told('the filter alone, a frame of 25 stars', whole[kernel], AIM_US, 'us')


if __name__ == '__main__':
    main()
