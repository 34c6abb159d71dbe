# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""S24 Figure 8: total error of the intrinsics over the number of frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from starcal_ros.config.scenario import Scenario
from starcal_ros.reproduction.outcome import Outcome
from starcal_ros.reproduction.self2024_sweep import sweep

RUNS = 400
PAPER_F_UM: Mapping[tuple[float, str], float] = {
    (100, 'TCOC'): 0.15, (100, 'TCWC'): 0.15, (100, 'SCOC'): 103.0, (100, 'SCWC'): 28.0}
NOTES = ('The errors fall with sqrt(NF NS), but for that of SCOC, which is its bias.',)


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the figure."""
    return sweep('S24 Figure 8: error over NF', 'frames', 'total', PAPER_F_UM, NOTES, runs,
                 scenario.simulation.seed, work, on_progress)
