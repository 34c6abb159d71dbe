# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""S24 Fig. 7: bias over the number of frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from starcal_ros.config import Scenario
from starcal_ros.evaluation import self2024_grid
from starcal_ros.evaluation.outcome import Outcome

RUNS = self2024_grid.RUNS
PAPER_F_UM: dict[tuple[str, float, int, int], float] = {}
NOTES = ('Of the traditional methods the bias is far below the total error, as S24 says.',)


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the grid; of the scenario only the seed matters."""
    return self2024_grid.figure(
        'S24 Fig. 7, bias over the number of frames', self2024_grid.over_frames(),
        'frames', True, runs, scenario.simulation.seed, work, on_progress, NOTES,
        PAPER_F_UM)
