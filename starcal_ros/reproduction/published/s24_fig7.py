# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""S24 Figure 7: bias of the intrinsics over the number of frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from starcal_ros.config.scenario import Scenario
from starcal_ros.reproduction.outcome import Outcome
from starcal_ros.reproduction.self2024_sweep import sweep

RUNS = 400
PAPER_F_UM: Mapping[tuple[float, str], float] = {}
NOTES = ('The paper states no number of this figure.',)


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the figure."""
    return sweep('S24 Figure 7: bias over NF', 'frames', 'bias', PAPER_F_UM, NOTES, runs,
                 scenario.simulation.seed, work, on_progress)
