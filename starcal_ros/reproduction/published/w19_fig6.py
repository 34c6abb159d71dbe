# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""W19 Fig. 6: how both methods converge, 19 stars a frame, 0.5 px."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.calibration.attitude_free import CameraBelief
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.reproduction import wu2019
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.wu2019 import GROUPS, METHODS, TRUTH
from starcal_ros.reproduction.wu2019_study import Row, Study

RUNS = 20
POINTS = 30
COUNTS = (10, 100, 2400)
NOTES = (
    'Criteria of the 100 frames to judge by after so many frames, mean of the runs. bound: what '
    'errors drawn from the Cramér-Rao bound of these frames give. B is the noise of the frames it '
    'is taken from, 26.4" at 0.5 px; the paper, whose B is 10.6", has that of 0.2 px.',
    'Both methods converge alike, as the paper says, because with the full weighting both use all '
    'that a frame tells; with the published one both fall behind, SVD more.')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run both methods with both weightings, and judge them on the way."""
    study = Study(scenario, GROUPS['group2'], runs)
    total = len(study.sky.calibrate)
    points = np.unique(np.geomspace(1, total, POINTS).astype(int))
    frames = points.astype(float)
    A: list[Curve] = []
    B: list[Curve] = []
    labels = [(method, weighting) for weighting in ('full', 'diagonal') for method in METHODS]
    for k, (method, weighting) in enumerate(labels):
        history: list[Array] = []

        def note(belief: CameraBelief) -> None:
            history.append(belief.parameters)

        wu2019.calibrate(study.sky.calibrate, study.calibrate_uv, study.sigma_px,
                         METHODS[method][weighting], note)
        judged = [history[point - 1] for point in points]
        name = f'{method}, {"published" if weighting == "diagonal" else weighting} weighting'
        A.append(Curve(frames, np.array([study.criterion_A(parameters).mean()
                                         for parameters in judged]), name))
        B.append(Curve(frames, np.array([wu2019.rmse_arcsec(
            parameters, study.sky.judge, study.judge_uv).mean() for parameters in judged]), name))
        on_progress((k + 1) / len(labels))
    A.append(Curve(frames, np.array([_bound(study, point) for point in points]), 'bound', 'limit'))
    rows: tuple[Row, ...] = tuple(
        (a.label, *(float(np.interp(count, frames, curve.y)) for curve in (a, b)
                    for count in COUNTS)) for a, b in zip(A, B))
    return Outcome(
        f'W19 Fig. 6, {runs} runs, {study.stars:.1f} stars a frame',
        ('method', *(f'{criterion}, {count} ["]' for criterion in 'AB' for count in COUNTS)),
        rows, NOTES,
        tuple(Panel(f'Criterion {name}', 'frames', 'RMSE ["]', tuple(curves), log=log)
              for name, curves, log in (('A', A, 'xy'), ('B', B, 'x'))))


def _bound(study: Study, frames: int) -> float:
    covariance = wu2019.cramer_rao(study.sky.calibrate[:frames], study.sigma_px)
    draws = np.random.default_rng(0).standard_normal((20, len(TRUTH)))
    return float(study.criterion_A(TRUTH + draws @ np.linalg.cholesky(covariance).T).mean())
