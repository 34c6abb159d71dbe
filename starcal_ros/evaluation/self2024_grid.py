# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What S24's Figures 5 to 8 are made of: the four methods over a grid of its experiment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from starcal_ros.evaluation import self2024
from starcal_ros.evaluation.outcome import Curve, Outcome, Panel
from starcal_ros.evaluation.self2024 import METHODS, Point

RUNS = 60
STARS = (20, 50, 100)
SIGMAS_PX, FRAMES = (0.01, 0.05, 0.1, 0.2, 0.5), (10, 30, 100)
COLUMNS = ('method', 'NS', 'NF', 'sigma (px)', 'x0 (px)', 'f (um)', 'paper f (um)')
NOTE = ('S24 has 100,000 rounds a point; give --rounds for more than these. sigma is that of the '
        'length of a centroid error, as S24 writes it.')


def over_sigma() -> list[Point]:
    """Return the points of Fig. 5 and 6: 100 frames."""
    return [Point(sigma, 100, stars) for stars in STARS for sigma in SIGMAS_PX]


def over_frames() -> list[Point]:
    """Return the points of Fig. 7 and 8: 0.1 px."""
    return [Point(0.1, frames, stars) for stars in STARS for frames in FRAMES]


def figure(title: str, points: list[Point], along: str, bias: bool, rounds: int, seed: int,
           work: Path, on_progress: Callable[[float], None], notes: tuple[str, ...],
           paper: Mapping[tuple[str, float, int, int], float]) -> Outcome:
    """Run the rounds of a grid and draw them.

    Parameters
    ----------
    title : str
        Which figure.
    points : list of Point
        The grid.
    along : str
        What the curves run along: ``sigma_px`` or ``frames``.
    bias : bool
        The bias rather than the total error.
    rounds, seed, work, on_progress
        As for `self2024.run`.
    notes : tuple of str
        Said beneath.
    paper : mapping
        What S24 has for f [um], by method, sigma, NF and NS.
    """
    results = self2024.run(points, rounds, seed, work, on_progress)
    count = results[0].error.shape[1]
    values = np.array([np.abs(one.bias) if bias else one.total for one in results])
    rows = tuple(
        (method, str(point.stars), str(point.frames), point.sigma_px, float(values[j, k, 0]),
         float(values[j, k, 2]),
         paper.get((method, point.sigma_px, point.frames, point.stars), ''))
        for k, method in enumerate(METHODS) for j, point in enumerate(points))
    x = {'sigma_px': 'centroid error [px]', 'frames': 'frames'}[along]
    what = 'bias' if bias else 'total error'
    panels = tuple(Panel(
        f'{method}: {what} of {name}', x, f'[{unit}]',
        tuple(Curve(np.array([getattr(point, along) for point in points if point.stars == stars],
                             float),
                    values[[point.stars == stars for point in points], k, column],
                    f'{stars} stars', 'marked') for stars in STARS), log='xy')
        for column, name, unit in ((2, 'f', 'um'), (0, 'x0', 'px'))
        for k, method in enumerate(METHODS))
    return Outcome(f'{title}, {count} rounds a point', COLUMNS, rows, (*notes, NOTE), panels)
