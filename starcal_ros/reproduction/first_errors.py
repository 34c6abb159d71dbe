# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs whose instruments differ from their nominal values as the initial sigmas say.

The runs of a Monte Carlo study have one truth, so that their first errors are the same: what the
filter is told of these, it can not be wrong about on the average. Here they are drawn.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from starcal_ros.config import models
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera, rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.units import ARCSEC
from starcal_ros.evaluation.estimation_error import nominal
from starcal_ros.filter.offline import calibrate
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth


def drawn(scenario: Scenario, seed: int) -> Scenario:
    """Return a scenario with another seed, and a truth that is drawn about the nominal values."""
    rng, sigma = np.random.default_rng([seed, 3]), scenario.estimator.initial_sigma
    bias = np.array(scenario.gyro.bias_deg_h) + sigma.gyro_bias_deg_h * rng.normal(size=3)
    turn = sigma.fixed_angles_arcsec * ARCSEC * rng.normal(size=3)
    C_sg = rotation.exp(-turn) @ models.mounting_matrix(scenario.mounting)
    lens = dict(zip(camera.INTRINSICS, models.intrinsics(scenario.camera)
                    + models.of_intrinsics(sigma) * rng.normal(size=len(camera.INTRINSICS))))
    return scenario.replace({
        'simulation.seed': seed,
        'truth.gyro.bias_deg_h': tuple(bias.tolist()),
        'truth.mounting.fixed_angles_deg': tuple(
            np.degrees(rotation.to_fixed_angles(C_sg)).tolist()),
        'truth.camera.focal_length_mm': float(lens['f']),
        'truth.camera.principal_point_px': tuple(float(lens[name]) for name in ('u0', 'v0')),
        'truth.camera.distortion': tuple(float(lens[name]) for name in ('k1', 'k2', 'p1', 'p2'))})


def nees(scenario: Scenario, runs: int, on_progress: Callable[[float], None]) -> Array:
    """Return the NEES of the 16 states at the end of runs with drawn first errors, (runs,)."""
    found = np.empty(runs)
    for k in range(runs):
        own = drawn(scenario, k + 1)
        gyro, tracker = sensors.gyro(own), sensors.star_tracker(own)
        calibrator, _ = calibrate(gyro.next(gyro.count), tracker.next(tracker.count), own)
        if calibrator.belief is None:
            raise ValueError(f'with seed {k + 1} no frame gave an attitude')
        found[k] = calibrator.belief.nees(nominal(Truth.from_scenario(own), calibrator.stamp_ns))
        on_progress((k + 1) / runs)
    return found
