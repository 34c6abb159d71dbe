# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""S24 Sec. 5, the point sigma = 0.1 px, NF = 100, NS = 20 that the paper states in numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.reproduction.outcome import Outcome
from starcal_ros.reproduction.self2024 import (CONSTRAINED, METHODS, NOTES, PAPER_LAMBDA,
                                               PAPER_STEPS, RESULTS, UNIT, Point, bound, rms, run)

RUNS = 2000
POINT = Point(sigma_px=0.1, frames=100, stars=20)
PAPER_F_UM = {'TCOC': 0.15, 'TCWC': 0.15, 'SCOC': 103.0, 'SCWC': 28.0}
PAPER_X0_PX = 0.37
_UNCONVERGED_UM = 0.05      # a third of the error of f in T


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the point."""
    rounds, = run([POINT], runs, scenario.simulation.seed, work, on_progress)
    limit = bound(POINT, scenario.simulation.seed) * UNIT
    total, bias = rounds.total, rounds.bias
    ms = rounds.ms.min(axis=1)
    x0 = np.sqrt(np.mean(total[:, :2]**2, axis=1))
    paper = rms(rounds.paper_error)
    rows: list[tuple[str | float, ...]] = [
        (name, float(total[k, 2]), PAPER_F_UM.get(name, ''), float(limit[int(name[0] == 'S'), 2]),
         float(bias[k, 2]), float(rounds.bias_sigma[k, 2]), float(x0[k]),
         PAPER_X0_PX if name in METHODS else '', float(ms[k])) for k, name in enumerate(RESULTS)]
    rows += [
        (f'{METHODS[k]} {PAPER_STEPS} steps', float(paper[row, 2]), PAPER_F_UM[METHODS[k]],
         float(limit[row, 2]), float(rounds.paper_error[row, :, 2].mean() * 1e3), '',
         float(np.sqrt(np.mean(paper[row, :2]**2))), PAPER_X0_PX, '')
        for row, k in enumerate(CONSTRAINED)]
    late = np.abs(rounds.paper_error[0, :, 2] - rounds.error[1, :, 2]) * 1e3 > _UNCONVERGED_UM
    notes = (
        *NOTES,
        f'The lower rows stop after {PAPER_STEPS} steps with lambda = {PAPER_LAMBDA:g}, as S24 '
        f'says it did: {100.0 * late.mean():.1f} % of the rounds of TCWC are then more than '
        f'{_UNCONVERGED_UM:g} um from where they converge, those whose stars are least spread, '
        'and they alone make the RMS. The upper rows have converged, by the method of Newton; so '
        'has what the paper reports.',
        'SCOC unbiased is not of S24: the expectation of the equations is subtracted; it starts '
        'at the result of SCWC. Times are CPU times, the least of the batches.')
    values = {name: {'f_error_um': float(total[k, 2]), 'f_bias_um': float(bias[k, 2]),
                     'x0_error_px': float(x0[k]), 'ms_per_round': float(ms[k])}
              for k, name in enumerate(METHODS)}
    return Outcome(
        f'S24, sigma {POINT.sigma_px:g} px, NF {POINT.frames}, NS {POINT.stars}: '
        f'{rounds.error.shape[1]} rounds',
        ('method', 'f um', 'paper f', 'bound', 'bias um', '+-', 'x0 px', 'paper x0', 'ms'),
        tuple(rows), notes, values=values)
