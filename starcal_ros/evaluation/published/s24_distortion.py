# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Beyond S24: self-calibration of a lens that distorts, when k1 is worth estimating.

The experiment of S24's typical point with a lens of some k1. The pinhole's SCWC, SCWC with k1
among its unknowns, and the bundle (`starcal_ros.bundle`) without and with k1.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from starcal_ros import bundle, camera, interstar
from starcal_ros.bundle import Spots
from starcal_ros.config import Scenario
from starcal_ros.evaluation import self2024
from starcal_ros.evaluation.outcome import Curve, Outcome, Panel
from starcal_ros.evaluation.self2024 import LARGEST, PITCH_MM, START, TRUTH, Point

Array = NDArray[np.float64]

RUNS = 24
EDGE_PX = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0)       # what k1 moves a star at the edge of the detector
NAMES = ('SCWC', 'SCWC, k1', 'bundle', 'bundle, k1')
COLUMNS = ('edge (px)', *NAMES, 'stated')
NOTES = (
    'RMS error of f [um]; 0.1 px, 100 frames, 20 stars, the same noise in each row. The pinhole '
    'takes distortion for focal length: 0.06 px at the edge of the detector cost it more than '
    'estimating k1 does.',
    'SCWC with k1 among its unknowns is no way out: its constraint weighs all angles alike, and f '
    'is then hardly known. In the bundle the directions of the stars are unknowns too; with k1 it '
    'has f to some 80 um in place of 25, whatever the distortion is, and states it.')
_EDGE_MM = self2024.HALF_PX * PITCH_MM
_WIDE = np.diag(np.array([1e3, 1e3, 10.0, 1e-2, 0.0, 0.0, 0.0])**2)
_PINHOLE = np.diag(np.array([1e3, 1e3, 10.0, 0.0, 0.0, 0.0, 0.0])**2)
_STEP_K1 = 1e-4
_FREE = 1e12            # gate: nothing is refused, there are no false spots


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the rounds of each size of k1; of the scenario only the seed matters."""
    rows = []
    for k, edge_px in enumerate(EDGE_PX):
        true = np.concatenate((TRUTH, np.zeros(4)))
        true[3] = edge_px * PITCH_MM / _EDGE_MM**3
        rng = np.random.default_rng((scenario.simulation.seed, 24))
        rounds = [_round(rng, true) for _ in range(runs)]
        error, sigma = (np.array(part) for part in zip(*rounds))
        rows.append((edge_px, *(np.sqrt(np.mean(error**2, axis=0)) * 1e3).tolist(),
                     float(np.sqrt(np.mean(sigma**2))) * 1e3))
        on_progress((k + 1) / len(EDGE_PX))
    table = np.array(rows)
    panel = Panel('Self-calibration of a lens that distorts', 'distortion at the edge [px]',
                  'RMS error of f [um]', tuple(
                      Curve(table[1:, 0], table[1:, k + 1], name, 'marked')
                      for k, name in enumerate(NAMES)), log='xy')
    return Outcome(f'S24 with distortion, {runs} rounds a row', COLUMNS,
                   tuple((f'{row[0]:g}', *row[1:]) for row in rows), NOTES, (panel,))


def _round(rng: np.random.Generator, true: Array) -> tuple[list[float], float]:
    """Return the errors of f of all that NAMES lists, and the last one's stated sigma [mm]."""
    point = Point()
    v, C_si = self2024.scenes(rng, 1, point)
    r_s = v[0] @ np.swapaxes(C_si[0], -1, -2)
    uv = camera.project(r_s, true, PITCH_MM)
    uv += point.sigma_px / np.sqrt(2.0) * rng.standard_normal(uv.shape)
    pinhole = interstar.solve(
        partial(self2024.evaluate, uv=uv[None], cosines=None, constrained=True), START[None],
        LARGEST, self2024.STEPS)[0]
    bent = interstar.solve(partial(_with_k1, uv=uv), np.append(pinhole, 0.0),
                           np.append(LARGEST, _STEP_K1), self2024.STEPS)
    found = [pinhole[2], bent[2]]
    begin = np.concatenate((START, np.zeros(4)))
    for prior in (_PINHOLE, _WIDE):
        adjusted = _adjusted(uv, point, begin, prior)
        found.append(adjusted.intrinsics[2])
    return [value - true[2] for value in found], float(np.sqrt(adjusted.covariance[2, 2]))


def _with_k1(x: Array, uv: Array) -> tuple[Array, Array]:
    """Return the value and the matrix of `interstar.solve` for u0, v0, f and k1, constrained."""
    seen = np.ones(uv.shape[:-1], bool)
    sight = interstar.lens(uv, np.concatenate((x, np.zeros(3))), PITCH_MM, range(4), True, seen)
    equations = interstar.equations(sight, None)
    return equations.value, equations.product(sight.by_intrinsics)


def _adjusted(uv: Array, point: Point, begin: Array, prior: Array) -> bundle.Adjusted:
    """Return the bundle of a round, begun at directions and attitudes that the start gives."""
    w_s = camera.unproject(uv, begin, PITCH_MM)
    C_si = bundle.wahba(np.swapaxes(w_s, -1, -2) @ w_s[0])
    points = (np.swapaxes(C_si, -1, -2) @ np.swapaxes(w_s, -1, -2)).sum(axis=0).T
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    frame, star = (part.ravel() for part in np.indices(uv.shape[:-1]))
    spots = Spots(frame, uv.reshape(-1, 2), np.full(len(frame), point.sigma_px / np.sqrt(2.0)),
                  np.zeros((len(frame), 3)), star)
    return bundle.adjust(spots, begin, C_si, points, PITCH_MM, prior, _FREE)
