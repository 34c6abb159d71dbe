# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18 Fig. 8: principal point and fixed angles, hour after hour, at a noise of 0.20 px."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.evaluation import bounds, montecarlo
from starcal_ros.evaluation.montecarlo import MonteCarlo
from starcal_ros.filter.states import STATE_NAMES, STATE_UNITS, UNIT
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.published import BESIDE, NOT_STATED, chance, table4

RUNS = 50
SIGMA_PX, LONGER, HOURS = 0.20, 2.5, 5      # five hours are 2.5 times the two of T18 Sec. 3.1
STATES = ('u0', 'v0', 'psi_x', 'psi_y')
ONLY_DRAWN = ('T18 draws Fig. 8 and states none of its numbers; those of its Table 4, of the same '
              'scenario, stand at two hours.')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the long study and take the errors after each fifth of it."""
    duration_s = LONGER * scenario.simulation.duration_s
    scenario = scenario.replace({table4.KEY: SIGMA_PX, 'simulation.duration_s': duration_s})
    results, = montecarlo.run(MonteCarlo(scenario, runs), work, on_progress=on_progress)
    time, period = results.time[0], 1.0 / scenario.star_tracker.rate_hz
    hours: Array = np.arange(1, HOURS + 1).astype(np.float64) * (duration_s / HOURS / 3600.0)
    taken = np.argmin(abs(time - (3600.0 * hours - period)[:, None]), axis=1)
    which = [STATE_NAMES.index(name) for name in STATES]
    rms = np.sqrt(np.mean(results.error[:, taken]**2, axis=0))[:, which] / UNIT[which]
    covariance = bounds.after(scenario, time[taken] + period)[:, which, which]
    bound = np.sqrt(covariance) / UNIT[which]
    # Two fifths in, where the scenario of Table 4 ends.
    paper = {name: {1: table4.PAPER[name][table4.VALUES.index(SIGMA_PX)]} for name in STATES}
    rows: list[tuple[str | float, ...]] = [
        (f'{hours[k]:g} h', name, STATE_UNITS[which[j]], paper[name].get(k, '-'),
         float(rms[k, j]), float(bound[k, j]), float(rms[k, j] / bound[k, j]))
        for k in range(HOURS) for j, name in enumerate(STATES)]
    panels = tuple(_panel(f'{name}, {STATE_UNITS[which[j]]}', hours, rms[:, j], bound[:, j],
                          paper[name]) for j, name in enumerate(STATES))
    return Outcome(f'T18 Fig. 8, centroids of {SIGMA_PX:.2f} px, RMS of {runs} runs', BESIDE,
                   tuple(rows), (NOT_STATED, ONLY_DRAWN, chance(runs)), panels)


def _panel(title: str, hours: Array, rms: Array, bound: Array, paper: dict[int, float]
           ) -> Panel:
    return Panel(title, 'time [h]', 'RMS error', (
        Curve(hours, rms, 'ours', 'marked'), Curve(hours, bound, 'bound', 'limit'),
        Curve(hours[list(paper)], np.array(list(paper.values())), 'T18 Table 4', 'paper')))
