# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""S24 Fig. 4: how the constrained methods converge for different lambda."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config import Scenario
from starcal_ros.evaluation import self2024
from starcal_ros.evaluation.outcome import Curve, Outcome, Panel
from starcal_ros.evaluation.self2024 import METHODS, START, TRUTH, Point

RUNS = 1
LAMBDAS = (1.0, 100.0, 200.0, 300.0)
ITERATIONS = 20
COLUMNS = ('method', 'lambda', 'iterations until f moves by less than 1 %')
NOTES = (
    'The matrix of Eq. 10 is the square of the constrained slopes, which are some 200 times too '
    'steep in f; lambda makes up for it. Without constraint lambda is 1 and five iterations do.',
    'The point where an iteration ends does not depend on lambda, as S24 says: it is where '
    "A'e = 0.")


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Iterate on one round; the number of runs does not matter."""
    rng = np.random.default_rng(scenario.simulation.seed)
    point = Point()
    v, C_si = self2024.scenes(rng, 1, point)
    uv = self2024.spots(v, C_si)
    uv += point.sigma_px / np.sqrt(2.0) * rng.standard_normal(uv.shape)
    cosines = v @ np.swapaxes(v, -1, -2)
    rows: list[tuple[str | float, ...]] = []
    panels = []
    for k, method in enumerate(METHODS):
        constrained = k in self2024.CONSTRAINED
        curves = []
        for scale in LAMBDAS if constrained else LAMBDAS[:1]:
            f_mm = _path(uv, cosines if k < 2 else None, constrained, scale)
            done = int(np.argmax(np.append(np.abs(np.diff(f_mm)) < 0.01 * f_mm[:-1], True)))
            rows.append((method, scale, float(done) if done < ITERATIONS else f'> {ITERATIONS}'))
            curves.append(Curve(np.arange(ITERATIONS + 1.0), f_mm, f'λ = {scale:g}', 'marked'))
        truth = Curve(np.array([0.0, ITERATIONS]), np.full(2, TRUTH[2]), 'truth', 'limit')
        panels.append(Panel(method, 'iteration', 'f [mm]', (*curves, truth)))
        on_progress((k + 1) / len(METHODS))
    return Outcome('S24 Fig. 4, convergence', COLUMNS, tuple(rows), NOTES, tuple(panels))


def _path(uv: NDArray[np.float64], cosines: NDArray[np.float64] | None, constrained: bool,
          scale: float) -> NDArray[np.float64]:
    """Return f after each iteration [mm]."""
    x = START[None].copy()
    f_mm = [float(x[0, 2])]
    for _ in range(ITERATIONS):
        value, matrix = self2024.evaluate(x, uv, cosines, constrained, scale)
        x = x - np.clip(np.linalg.solve(matrix, value[..., None])[..., 0], -self2024.LARGEST,
                        self2024.LARGEST)
        f_mm.append(float(x[0, 2]))
    return np.array(f_mm)
