# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The truth of a calibration about its error where the noise levels are stated wrong.

Runs T18's scenario with centroid sigma and angular random walk stated too large or too small by a
factor, each alone and both, calibrates with ``estimator.adapt`` and prints the levels, and the
mean NEES of each case with the 95 % interval of a true filter. The live way has one pass, in
which levels come down from above. Run it with ``python bench/noise_levels.py --seeds 20``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from starcal_ros.config import parameter_file
from starcal_ros.config.scenario import Scenario
from starcal_ros.evaluation.consistency import mean_interval
from starcal_ros.evaluation.estimation_error import nominal
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.noise import Noise
from starcal_ros.filter.noise_levels import CENTROIDS, GYRO, NoiseLevel
from starcal_ros.filter.noise_search import levels
from starcal_ros.filter.states import N_STATES
from starcal_ros.measurements.message_source import InMemory
from starcal_ros.results.result import word
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

CONFIG = Path(__file__).resolve().parents[1] / 'config' / 'tan2018.yaml'


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--seeds', type=int, default=20, help='runs of each case')
    parser.add_argument('--first', type=int, default=1, help='first seed')
    parser.add_argument('--minutes', type=float, default=15.0, help='length of a run')
    parser.add_argument('--factor', type=float, default=10.0, help='by which levels are off')
    parser.add_argument('--rotate', action='store_true', help='one case a seed, in turn')
    options = parser.parse_args()
    scenario = parameter_file.load(CONFIG).replace(
        {'simulation.duration_s': 60.0 * options.minutes})
    cases = list(product((1.0, options.factor, 1.0 / options.factor), repeat=2))
    nees: dict[tuple[str, str], list[float]] = {}
    for k in range(options.seeds):
        for case in [cases[k % len(cases)]] if options.rotate else cases:
            name = 'sigma x {:g}, walk x {:g}'.format(*case)
            for way, found, value, said in run(scenario, options.first + k, *case):
                print(f'seed {options.first + k:3} {name:24} {way:9} NEES {value:6.1f} {said:12} '
                      + ', '.join(f'{each.value:.3g} +- {each.spread:.0%}' for each in found),
                      flush=True)
                for group in (name, 'all'):
                    nees.setdefault((way, group), []).append(value)
    for (way, name), values in nees.items():
        low, high = mean_interval(N_STATES, len(values), 0.95)
        print(f'{way:9} {name:24} {len(values):3} runs, NEES {np.mean(values):5.2f} '
              f'({low:.2f} to {high:.2f})')


def run(scenario: Scenario, seed: int, sigma: float, walk: float
        ) -> Iterator[tuple[str, tuple[NoiseLevel, ...], float, str]]:
    """Yield what each way makes of one run: its name, the levels, the NEES and the verdict."""
    simulated = scenario.replace({'simulation.seed': seed})
    stated = simulated.replace({
        CENTROIDS: sigma * scenario.star_tracker.centroid_sigma_px,
        GYRO: walk * scenario.gyro.arw_deg_sqrt_h, 'estimator.adapt': (CENTROIDS, GYRO)})
    gyro, tracker = sensors.gyro(simulated), sensors.star_tracker(simulated)
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    frames = replace(frames, sigma=np.full_like(frames.sigma, 0.0))     # that is, as stated
    ways = [('recording', Noise(stated, levels(InMemory(samples, frames), stated)))]
    for way, noise in [*ways, ('live', None)]:
        calibrator = Calibrator(stated, noise=noise)
        calibrator.add_gyro(samples)
        calibrator.add_frames(frames)
        for _ in calibrator.process():
            pass
        true = nominal(Truth.from_scenario(simulated), calibrator.stamp_ns)
        assert calibrator.belief is not None
        yield (way, tuple(calibrator.noise.levels()), float(calibrator.belief.nees(true)),
               word(calibrator))


if __name__ == '__main__':
    main()
