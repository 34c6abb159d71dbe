# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""S24 Fig. 6: total error over the centroid error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from starcal_ros.config import Scenario
from starcal_ros.evaluation import self2024_grid
from starcal_ros.evaluation.outcome import Outcome

RUNS = self2024_grid.RUNS
PAPER_F_UM = {('SCOC', 0.2, 100, 20): 500.0, ('SCWC', 0.2, 100, 20): 55.0}
NOTES = ('From 0.2 px on SCOC does not converge to anything near the camera, as S24 says.',)


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the grid; of the scenario only the seed matters."""
    return self2024_grid.figure(
        'S24 Fig. 6, total error over the centroid error', self2024_grid.over_sigma(),
        'sigma_px', False, runs, scenario.simulation.seed, work, on_progress, NOTES,
        PAPER_F_UM)
