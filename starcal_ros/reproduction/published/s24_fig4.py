# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""S24 Figure 4: how the iteration converges with lambda, and Newton's method beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from starcal_ros.calibration import interstar_equations as interstar
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.self2024 import (CONSTRAINED, LARGEST, METHODS, NOTES, START, TRUTH,
                                               Point, evaluate, scenes, spots)

RUNS = 24
STEPS = {1.0: 1000, 50.0: 60, 100.0: 40, 200.0: 40, 300.0: 40, 500.0: 40}
"""Iterations with each lambda."""
PLAIN = {1.0: 10}           # without constraint: lambda = 1 is Gauss-Newton
NEWTON = 10                 # steps of Newton's method
_REACHED_UM = 0.05
_AT_ONCE = 8                # rounds
_NOTES = (
    'Drawn is the RMS over the rounds of how far f is from where it converges. The paper says of '
    'WC: some 1000 steps with lambda = 1, 5 to 10 with 100 to 200, fluctuation at 300, divergence '
    'at 500; of OC: five.',
    'Without constraint this is the Gauss-Newton method. With it the derivative of the residuals '
    'is not A but 200 to 300 times less, as the angle enters squared: lambda stands for that '
    'factor, 2 over the mean square of the angle between stars, which differs between scenes. '
    'The matrix of Newton has the factor in it and needs no lambda.')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the figure."""
    point = Point()
    rng = np.random.default_rng(scenario.simulation.seed)
    v, C_si = scenes(rng, runs, point)
    uv = spots(v, C_si)
    uv = uv + point.sigma_px / np.sqrt(2.0) * rng.standard_normal(uv.shape)
    rows: list[tuple[str | float, ...]] = []
    panels = []
    for k, name in enumerate(METHODS):
        constrained = k in CONSTRAINED
        cosines = v @ np.swapaxes(v, -1, -2) if name.startswith('T') else None
        newton = _history(uv, cosines, constrained, None, NEWTON)
        end = newton[-1]
        curves = []
        ways = {'Newton': newton} if constrained else {}
        ways.update({f'lambda = {scale:g}': _history(uv, cosines, constrained, scale, steps)
                     for scale, steps in (STEPS if constrained else PLAIN).items()})
        for label, history in ways.items():
            away = np.abs(history - end) * 1e3
            rms = np.sqrt(np.mean(away**2, axis=1))
            step = np.arange(1, len(rms)).astype(np.float64)
            curves.append(Curve(step, np.maximum(rms[1:], 1e-6), label))
            settled = np.maximum.accumulate(away[::-1], axis=0)[::-1] <= _REACHED_UM
            first = np.where(settled.any(axis=0), settled.argmax(axis=0), len(history))
            rows.append((name, label, float(np.median(first)), float(first.max()),
                         float(rms[min(10, len(rms) - 1)]), float(settled[-1].mean() * 100.0)))
        error = np.sqrt(np.mean((end - TRUTH[2])**2)) * 1e3
        span = np.array([1.0, STEPS[1.0] if constrained else PLAIN[1.0]])
        curves.append(Curve(span, np.full(2, error), 'error of f', 'limit'))
        panels.append(Panel(name, 'iteration', 'f from its end [um]', tuple(curves), log='xy'))
        on_progress((k + 1) / len(METHODS))
    return Outcome(f'S24 Figure 4: convergence, {runs} rounds',
                   ('method', 'step', 'steps, median', 'most', 'f um off after 10', 'settled %'),
                   tuple(rows), (*NOTES[:2], *_NOTES), tuple(panels))


def _history(uv: Array, cosines: Array | None, constrained: bool, scale: float | None, steps: int
             ) -> Array:
    """Return f before and after each step, (steps + 1, rounds)."""
    parts = []
    for low in range(0, len(uv), _AT_ONCE):
        rows = slice(low, low + _AT_ONCE)
        parts.append(np.stack(list(_iterates(partial(
            evaluate, uv=uv[rows], cosines=None if cosines is None else cosines[rows],
            constrained=constrained, scale=scale), len(uv[rows]), steps)))[..., 2])
    return np.concatenate(parts, axis=1)


def _iterates(problem: Callable[[Array], tuple[Array, Array]], rounds: int, steps: int
              ) -> Iterator[Array]:
    x = np.broadcast_to(START, (rounds, 3))
    yield x
    for _ in range(steps):
        x = interstar.solve(problem, x, LARGEST, 1)
        yield x
