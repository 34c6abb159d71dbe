# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""W19 Fig. 3: observability of the star combination models, frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.reproduction import wu2019
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.wu2019 import PerfectFrame

RUNS = 100
"""Frames."""

NUMBERINGS: Mapping[str, Callable[[PerfectFrame], Sequence[int]]] = {
    'Hipparcos number': lambda view: range(len(view.uv)),
    'from the middle outwards': lambda view: np.argsort(np.linalg.norm(
        view.uv - wu2019.DETECTOR.centre_raster, axis=-1)).tolist(),
}
NOTES = (
    'Minimum singular value (MSV) of the slopes of sigma1, sigma2 and sigma3, each parameter in '
    'units of Table 1; W19 states neither the frames nor the numbering of the stars.',
    'That Model 4 is the most observable one is a matter of the numbering: it is with stars '
    'numbered from the middle of the detector outwards, not with Hipparcos numbers. No MSV counts '
    'how residuals are correlated; with the full weighting the models differ little (Table 2).')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Compute the MSV of each model."""
    frames = wu2019.rich_views(scenario, runs)
    panels, rows = [], []
    for k, (name, order) in enumerate(NUMBERINGS.items()):
        numbered = [PerfectFrame(view.u_i[order(view)], view.uv[order(view)]) for view in frames]
        msv = np.array([[wu2019.least_observable(view, model, (1, 2, 3)) for view in numbered]
                        for model in range(1, 5)])
        best = np.bincount(np.argmax(msv, axis=0), minlength=4) / len(frames)
        panels.append(Panel(name, 'frame', 'MSV', tuple(
            Curve(np.arange(len(frames), dtype=float), values, f'Model {model}')
            for model, values in enumerate(msv, start=1)), log='y'))
        rows += [(name, f'Model {model}', float(np.median(msv[model - 1])),
                  float(best[model - 1])) for model in range(1, 5)]
        on_progress((k + 1) / len(NUMBERINGS))
    return Outcome(f'W19 Fig. 3, {len(frames)} frames',
                   ('numbering', 'model', 'median MSV', 'part of the frames it is largest in'),
                   tuple(rows), NOTES, tuple(panels))
