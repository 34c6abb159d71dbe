# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18 Fig. 5: attitude errors of the gyro units, with the star tracker and without."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.units import ARCSEC, DEG_PER_SQRT_HOUR
from starcal_ros.evaluation import bounds
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import PHI, STATE_NAMES
from starcal_ros.reproduction import traces
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.published import BESIDE, NOT_STATED, chance
from starcal_ros.simulation.truth import Truth

RUNS = traces.RUNS
PAPER_ARCSEC = (0.65, 0.31, 0.53)       # RMS from 1 h to 2 h
AXES = ('phi is the error about the axes of ICRS, to which T18 does not say how its gyros stand: '
        'its three numbers need not come in the order of ours.')
ALONE = ('gyro alone: integrated with the nominal bias from the first fix, which the nominal '
         'mounting has wrong. The drift is what bias and random walk add to that; without what '
         'the bias adds the random walk is left, ARW sqrt(T), which is given as its bound.')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Compare the attitude of the filter with that of the gyro alone."""
    trace = traces.of(scenario, runs, work, on_progress)
    phi, drift = trace.error[..., PHI] / ARCSEC, trace.drift / ARCSEC
    limit = np.diagonal(traces.bounds_of_second_half(scenario), axis1=-2, axis2=-1)[:, PHI]
    walk = (scenario.gyro.arw_deg_sqrt_h * DEG_PER_SQRT_HOUR / ARCSEC
            * float(np.sqrt(trace.time[-1] - trace.time[0])))
    walked = drift[:, -1] - bias_drift(scenario, trace.time) / ARCSEC
    rows: list[tuple[str | float, ...]] = []
    for name, paper, ours, bound in (
            ('with stars, second half', PAPER_ARCSEC, phi[:, trace.second_half],
             np.sqrt(limit.mean(axis=0)) / ARCSEC),
            ('gyro alone, first fix', None, phi[:, :1], None),
            ('gyro alone, drift', None, drift[:, -1:], None),
            ('drift without bias', None, walked[:, None], np.full(3, walk) if walk else None)):
        rms = np.sqrt(np.mean(ours**2, axis=(0, 1)))
        rows += [(name, STATE_NAMES[k], 'arcsec', '-' if paper is None else paper[k],
                  float(rms[k]), *(('-', '-') if bound is None else
                                   (float(bound[k]), float(rms[k] / bound[k]))))
                 for k in range(3)]
    minutes = trace.time / 60.0
    settled = 5.0 * float(trace.sigma[0, len(minutes) // 5, PHI].max()) / ARCSEC
    panels = (
        Panel('With the star tracker', 'time [min]', 'attitude error [arcsec]', tuple(
            Curve(minutes, phi[0, :, k], STATE_NAMES[k]) for k in range(3)),
            y_limits=(-settled, settled)),
        Panel('Without: drift since the first fix', 'time [min]', 'attitude error [arcsec]', tuple(
            Curve(minutes, drift[0, :, k], STATE_NAMES[k]) for k in range(3))))
    return Outcome(
        f'T18 Fig. 5, attitude errors; drawn: one run, table: RMS of {runs}', BESIDE, tuple(rows),
        (NOT_STATED, AXES, ALONE, chance(runs)), panels)


def bias_drift(scenario: Scenario, time: Array) -> Array:
    """Return the drift of the gyro alone that its bias makes over all times, (3,), in i [rad]."""
    truth = Truth.from_scenario(scenario)
    stamps = truth.motion.start_ns + np.rint(time * 1e9).astype(np.int64)
    epsilon = Filter(scenario).start.bias - truth.bias
    return bounds.turned(truth.motion, stamps).sum(axis=0) @ epsilon
