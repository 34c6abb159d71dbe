# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""W19 Fig. 4: observability of each of the three singular values, frame by frame."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.reproduction import wu2019
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel

RUNS = 100
"""Frames."""

NOTES = (
    'Minimum singular value (MSV) of the slopes of one singular value over the groups of Model 4, '
    'each parameter in units of Table 1.',
    'sigma1 is the least observable in almost all frames, as in the paper: it hardly changes with '
    'the directions. But it is as little moved by their noise: with the full weighting, sigma1 '
    'alone calibrates within a factor of two of the bound (Table 3).')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Compute the MSV of each singular value."""
    frames = wu2019.rich_views(scenario, runs)
    msv = np.array([[wu2019.least_observable(view, 4, (number,)) for view in frames]
                    for number in (1, 2, 3)])
    on_progress(1.0)
    least = np.bincount(np.argmin(msv, axis=0), minlength=3) / len(frames)
    rows = tuple((f'sigma{number}', float(np.median(msv[number - 1])), float(least[number - 1]))
                 for number in (1, 2, 3))
    panel = Panel('Model 4', 'frame', 'MSV', tuple(
        Curve(np.arange(len(frames), dtype=float), values, f'sigma{number}')
        for number, values in enumerate(msv, start=1)), log='y')
    return Outcome(f'W19 Fig. 4, {len(frames)} frames',
                   ('singular value', 'median MSV', 'part of the frames it is least in'), rows,
                   NOTES, (panel,))
