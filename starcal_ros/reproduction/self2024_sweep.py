# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bias and total error of S24's methods over sigma and NF, for some NS: its Figures 5 to 8."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.self2024 import NOTES, RESULTS, UNIT, Point, bound, run

STARS = (20, 60, 100)
VALUES: dict[str, tuple[float, ...]] = {'sigma_px': (0.01, 0.03, 0.1, 0.2, 0.5),
                                        'frames': (10, 20, 50, 100)}
AXES = {'sigma_px': 'sigma [px]', 'frames': 'NF'}
INTRINSICS = {2: 'f [um]', 0: 'x0 [px]'}
_SCENES = 2                 # for the bound


def sweep(title: str, key: str, statistic: str, paper: Mapping[tuple[float, str], float],
          notes: Sequence[str], rounds: int, seed: int, work: Path,
          on_progress: Callable[[float], None]) -> Outcome:
    """Run a figure.

    Parameters
    ----------
    title : str
        Which one.
    key : str
        What is varied within a panel, a field of `Point`; NS is from panel to panel.
    statistic : str
        ``bias`` or ``total`` error.
    paper : mapping
        What S24 states of f [um] at NS = 20, by value and method.
    notes : sequence of str
        What is to be said of this figure.
    rounds, seed, work, on_progress
        As for `self2024.run`.
    """
    values = VALUES[key]
    varied: list[dict[str, Any]] = [{key: value} for value in values]
    points = [replace(Point(), stars=stars, **part) for stars in STARS for part in varied]
    results = run(points, rounds, seed, work, on_progress)
    numbers = np.array([getattr(result, statistic) for result in results])
    beside = (np.array([result.bias_sigma for result in results]) if statistic == 'bias'
              else np.array([_limit(point, seed) for point in points]))
    rows = tuple(
        (f'NS = {point.stars}, {AXES[key]} = {getattr(point, key):g}', name,
         float(numbers[n, k, 2]), float(beside[n, k, 2]), float(numbers[n, k, 0]),
         float(beside[n, k, 0]), _stated(paper, point, key, name))
        for n, point in enumerate(points) for k, name in enumerate(RESULTS))
    panels = tuple(
        _panel(f'NS = {stars}', key, which, numbers[part], beside[part], statistic,
               paper if (stars, which) == (STARS[0], 2) else {})
        for which in INTRINSICS for stars, part in zip(
            STARS, np.split(np.arange(len(points)), len(STARS))))
    other = '+-' if statistic == 'bias' else 'bound'
    return Outcome(f'{title}, {results[0].error.shape[1]} rounds', (
        'point', 'method', 'f um', other, 'x0 px', other, 'paper f'),
        rows, (*NOTES, *notes), panels)


def _limit(point: Point, seed: int) -> Array:
    """Return the bound of each method, (5, 3), in px, px, um."""
    return bound(point, seed, count=_SCENES)[[int(name[0] == 'S') for name in RESULTS]] * UNIT


def _stated(paper: Mapping[tuple[float, str], float], point: Point, key: str, name: str
            ) -> str | float:
    return paper.get((getattr(point, key), name), '') if point.stars == STARS[0] else ''


def _panel(title: str, key: str, which: int, numbers: Array, beside: Array, statistic: str,
           paper: Mapping[tuple[float, str], float]) -> Panel:
    x = np.array(VALUES[key])
    curves = [Curve(x, np.abs(numbers[:, k, which]), name, 'marked')
              for k, name in enumerate(RESULTS)]
    if statistic == 'total':
        curves += [Curve(x, beside[:, k, which], name, 'limit')
                   for k, name in ((0, 'bounds, T and S'), (2, ''))]
    if paper:
        curves.append(Curve(np.array([value for value, _ in paper]),
                            np.array(list(paper.values())), 'paper', 'paper'))
    return Panel(title, AXES[key], f'{statistic} of {INTRINSICS[which]}', tuple(curves), log='xy')
