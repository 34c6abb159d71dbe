# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18 Fig. 4: the error of the lens distortion over the detector, before and after."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.models import intrinsics
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import camera
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import INTRINSICS_SCALE
from starcal_ros.evaluation import bounds
from starcal_ros.filter.states import LENS
from starcal_ros.reproduction import traces
from starcal_ros.reproduction.outcome import Field, Outcome, Panel
from starcal_ros.reproduction.published import BESIDE, NOT_STATED, chance
from starcal_ros.simulation.truth import Truth

RUNS = traces.RUNS
PAPER_PX = (3.0, 0.032)     # at the edge of the detector, before and after
AT_THE_EDGE = ('T18 gives the error of one run at the edge of the detector; ours is the RMS of '
               'all runs at the worst place, and over all places.')
_SIDE = 33                  # places along each side of the detector, its edges among them


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Compare the nominal and the calibrated distortion with the true one."""
    error = traces.of(scenario, runs, work, on_progress).error[:, -1, LENS]
    truth = Truth.from_scenario(scenario)
    true, pitch_mm = truth.intrinsics, truth.detector.pitch_mm
    u, v = (np.linspace(-0.5, 0.5, _SIDE, dtype=np.float64) * size
            for size in (truth.detector.width, truth.detector.height))
    place = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)

    def wrong(lens: Array) -> Array:
        """Return the error of the distortion of cameras (..., 7), (..., n, 2) [px]."""
        return camera.distortion(place, lens, pitch_mm) - camera.distortion(place, true, pitch_mm)

    before, after = wrong(intrinsics(scenario.camera)), wrong(true + error)
    step = np.diag(INTRINSICS_SCALE)
    slope = (wrong(true + step) - wrong(true - step)) / (2.0 * INTRINSICS_SCALE)[:, None, None]
    covariance = bounds.after(scenario, [scenario.simulation.duration_s])[0, LENS, LENS]
    bound = np.sqrt(np.einsum('inc,ij,jnc->n', slope, covariance, slope))
    rms = np.sqrt(np.mean(np.sum(after**2, axis=-1), axis=0))
    rows: list[tuple[str | float, ...]] = [
        ('before', 'largest', 'px', PAPER_PX[0], float(_size(before).max()), '-', '-')]
    rows += [('after', name, 'px', paper, ours, limit, ours / limit)
             for name, paper, ours, limit in (
                 ('largest', PAPER_PX[1], float(rms.max()), float(bound.max())),
                 ('mean square', '-', _mean_square(rms), _mean_square(bound)))]
    fields = (Field(u, v, _size(shift).reshape(_SIDE, _SIDE), shift.reshape(_SIDE, _SIDE, 2))
              for shift in (before, after[0]))
    panels = tuple(Panel(f'{name} [px]', 'u from the centre [px]', 'v from the centre [px]',
                         field=field)
                   for name, field in zip(('Before calibration', 'After, one run'), fields))
    return Outcome(
        f'T18 Fig. 4, lens distortion error; drawn: one run, table: RMS of {runs}', BESIDE,
        tuple(rows), (NOT_STATED, AT_THE_EDGE, chance(runs)), panels)


def _size(shift: Array) -> Array:
    return np.linalg.norm(shift, axis=-1)


def _mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
