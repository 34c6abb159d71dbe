# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a gyro reading costs while no star frame comes: after 10 s, and after 58 minutes.

Usage: python bench/gyro_reading.py. Each calibration gets ten seconds of readings and frames, then
readings alone, one at a time as a live node does; the median of 500 is taken.
"""

from time import perf_counter

import numpy as np

from starcal_ros import calibration
from starcal_ros.config import parameter_file
from starcal_ros.config.shipped import config_file
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.identification.frame_identifier import FrameIdentifier
from starcal_ros.measurements.samples import GyroSamples
from starcal_ros.simulation import sensors

AFTER_S = (10.0, 58.0 * 60.0)
READINGS = 500
SCENARIO = parameter_file.load(config_file('tan2018.yaml')).replace(
    {'simulation.duration_s': 10.0, 'intrinsics.method': 'interstar'})


def main() -> None:
    """Measure and print."""
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    filter_, camera, identifier = (Calibrator(SCENARIO), calibration.start(SCENARIO),
                                   FrameIdentifier(SCENARIO))

    def live(part: GyroSamples) -> None:
        filter_.add_gyro(part)
        list(filter_.process(tracked=True))
        filter_.track()

    def asked(part: GyroSamples) -> None:
        camera.add_gyro(part)
        camera.estimate()

    cases = {'16-state filter': (filter_, live), 'interstar (SCOC)': (camera, asked),
             'identification': (identifier, identifier.add_gyro)}
    for name, (begun, step) in cases.items():
        begun.add_frames(frames)
        step(samples)
        cost, fed = [], 0
        for after in AFTER_S:
            n = round(after * 100.0) - fed
            for low in range(0, n, 1000):
                step(silent(samples, fed + low, min(1000, n - low)))
            seconds = []
            for k in range(READINGS):
                part = silent(samples, fed + n + k, 1)
                began = perf_counter()
                step(part)
                seconds.append(perf_counter() - began)
            fed += n + READINGS
            cost.append(float(np.median(seconds)))
        print(f'{name:18} {cost[0] * 1e3:8.3f} ms after 10 s, {cost[1] * 1e3:8.3f} ms after '
              f'58 min: {cost[1] / cost[0]:.2f} times')


def silent(samples: GyroSamples, first: int, count: int) -> GyroSamples:
    """Return readings that follow the simulated ones, at rest."""
    stamps = samples.stamp_ns[-1] + 10_000_000 * np.arange(first + 1, first + count + 1)
    return GyroSamples(stamps, np.tile(samples.rate[-1], (count, 1)))


if __name__ == '__main__':
    main()
