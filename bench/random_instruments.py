# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Whether the filter is consistent for instruments that nobody chose.

Draws camera, gyros, mounting, rates, noise, motion, initial sigmas, wrong stars and optional
states at random, the truth from the initial sigmas, simulates and calibrates, and prints what is
known, the NEES with its probability, and the tests that fail. In the end: how many are in their
band, how many contradict the model, and whether any is wrong without a word. Run it with
``python bench/random_instruments.py --runs 100``.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from starcal_ros.config import models, parameter_file
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.distributions import chi2_sf
from starcal_ros.evaluation.estimation_error import nominal
from starcal_ros.filter.offline import calibrate
from starcal_ros.results.result import word
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

CONFIG = Path(__file__).resolve().parents[1] / 'config' / 'tan2018.yaml'
UNLIKELY = 1e-4
"""Probability of a NEES below which the sigmas are not the errors'."""


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--runs', type=int, default=100)
    parser.add_argument('--first', type=int, default=1, help='first seed')
    parser.add_argument('--minutes', type=float, default=15.0, help='length of a run')
    options = parser.parse_args()
    counts = {'in its band': 0, 'doubted, in its band': 0, 'doubted': 0, 'WRONG': 0}
    for seed in range(options.first, options.first + options.runs):
        scenario = drawn(seed).replace({'simulation.duration_s': 60.0 * options.minutes})
        gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
        calibrator, _ = calibrate(
            gyro.next(gyro.count), tracker.next(tracker.count), scenario)
        assert calibrator.belief is not None
        true = nominal(Truth.from_scenario(scenario), calibrator.stamp_ns,
                       calibrator.filter.augmentation)
        n, nees = len(calibrator.filter.scale), float(calibrator.belief.nees(true))
        failed = [each.name for each in calibrator.consistency.statistics() if not each.passed]
        right = float(chi2_sf(nees, n)) > UNLIKELY
        kind = (('doubted, in its band' if right else 'doubted') if failed
                else 'in its band' if right else 'WRONG')
        counts[kind] += 1
        stars = calibrator.counts.stars / max(calibrator.counts.frames, 1)
        print(f'seed {seed:4} {n} states, {scenario.gyro.arw_deg_sqrt_h:.2g} deg/sqrt(h), '
              f'{scenario.star_tracker.centroid_sigma_px:.2g} px, {stars:.0f} stars at '
              f'{scenario.star_tracker.rate_hz:g} Hz: NEES {nees:.1f}, {word(calibrator)}, '
              f'{kind} {", ".join(failed)}', flush=True)
    print(', '.join(f'{number} {kind}' for kind, number in counts.items()))


def drawn(seed: int) -> Scenario:
    """Return an instrument and its truth, of which both are drawn."""
    rng = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    def off(sigma: float, count: int) -> tuple[float, ...]:
        return tuple(map(float, sigma * rng.normal(size=count)))

    side, pitch = int(rng.choice([512, 1024, 2048])), float(rng.choice([0.0055, 0.0074, 0.015]))
    field, half = between(6.0, 40.0), 0.5 * side * pitch
    f = half / float(np.tan(np.radians(0.5 * field)))
    sigma = {'gyro_bias_deg_h': between(0.05, 200.0), 'fixed_angles_arcsec': between(10.0, 1500.0),
             'principal_point_px': between(0.5, 20.0), 'focal_length_mm': f * between(2e-4, 2e-2),
             'k1': 2e-3 / half**2 * between(0.1, 3.0), 'k2': 1e-3 / half**4 * between(0.1, 3.0),
             'p1': 5e-4 / half * between(0.1, 3.0)}
    sigma['p2'] = sigma['p1']
    quaternion, start = (q / np.linalg.norm(q) for q in rng.normal(size=(2, 4)))
    values: dict[str, Any] = {
        'simulation.seed': seed,
        'camera.width': side, 'camera.height': side, 'camera.pixel_pitch_mm': pitch,
        'camera.focal_length_mm': f, 'camera.principal_point_px': (0.0, 0.0),
        'camera.distortion': (0.0, 0.0, 0.0, 0.0),
        'truth.camera.focal_length_mm': f + off(sigma['focal_length_mm'], 1)[0],
        'truth.camera.principal_point_px': off(sigma['principal_point_px'], 2),
        'truth.camera.distortion': (*off(sigma['k1'], 1), *off(sigma['k2'], 1),
                                    *off(sigma['p1'], 2)),
        'gyro.rate_hz': float(rng.choice([20.0, 50.0, 100.0, 200.0])),
        'gyro.arw_deg_sqrt_h': between(3e-4, 0.6), 'gyro.bias_deg_h': (0.0, 0.0, 0.0),
        'truth.gyro.bias_deg_h': off(sigma['gyro_bias_deg_h'], 3),
        'star_tracker.rate_hz': float(rng.choice([1.0, 2.0, 2.7, 4.0, 5.0, 10.0])),
        'star_tracker.exposure_s': float(rng.choice([0.0, 0.05, 0.1])),
        'star_tracker.centroid_sigma_px': between(0.03, 0.3),
        # As many stars in a narrow field as in a wide one, and no more than a catalogue has.
        'star_tracker.limiting_magnitude': float(np.clip(
            8.3 - 2.7 * np.log10(field / 6.0) + rng.uniform(-0.5, 0.0), 5.0, 8.3)),
        'truth.star_tracker.misidentified_fraction': float(rng.choice([0.0, 0.0, 0.02, 0.1])),
        'motion.rate_deg_s': between(0.05, 3.0), 'motion.acceleration_deg_s2': between(0.1, 5.0),
        'motion.dwell_s': float(rng.uniform(5.0, 60.0)),
        'motion.initial_quaternion_xyzw': tuple(map(float, start)),
        'mounting.quaternion_xyzw': tuple(map(float, quaternion)),
        **{f'estimator.initial_sigma.{name}': value for name, value in sigma.items()},
        **_optional(rng)}
    scenario = parameter_file.load(CONFIG).replace(values)
    turn = np.radians(sigma['fixed_angles_arcsec'] / 3600.0) * rng.normal(size=3)
    C_sg = rotation.exp(turn) @ models.mounting_matrix(scenario.mounting)
    return scenario.replace({'truth.mounting.fixed_angles_deg': tuple(map(
        float, np.degrees(rotation.to_fixed_angles(C_sg))))})


def _optional(rng: np.random.Generator) -> Mapping[str, Any]:
    """Return optional states, each in a third of the instruments, and their truth."""
    values: dict[str, Any] = {}
    if rng.random() < 1.0 / 3.0:
        values |= {'estimator.augment.time_offset_sigma_s': 0.005,
                   'truth.star_tracker.time_offset_s': float(0.005 * rng.normal())}
    if rng.random() < 1.0 / 3.0:
        values |= {'estimator.augment.gyro_matrix_sigma_ppm': 1000.0,
                   'truth.gyro.scale_factor_ppm': tuple(map(float, 1000.0 * rng.normal(size=3)))}
    return values


if __name__ == '__main__':
    main()
