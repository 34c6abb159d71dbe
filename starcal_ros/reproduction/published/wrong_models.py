# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Models that are wrong, one at a time: how large the error is, and whether it was said.

`LIVE` of the rows run once more as the suite's nodes, over ROS 2 where that is here.

Right ones, ten times as many as of a wrong one, show how often a false alarm is raised.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
import shutil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros.config.scenario import Scenario
from starcal_ros.evaluation.tasks import complete
from starcal_ros.filter.states import CALIBRATED, PHI
from starcal_ros.core.verdict_words import CONVERGED, INCONSISTENT, LOST
from starcal_ros.reproduction import wrong_models
from starcal_ros.reproduction.outcome import Outcome
from starcal_ros.reproduction.wrong_models import CLEAN, ROWS, WrongModel
from starcal_ros.workflows.node_program import NodeError

RUNS = 20
CLEAN_RUNS = 10         # for each run of a row
LIVE = ('star stamps 5 ms late', 'angular random walk 10 times the stated',
        'gyro scale of 300 ppm', 'centroid noise 3 times the stated',
        'orbit believed at the geocentre')
_LIVE_S = 900.0         # length of a live run, at most
_ALLOWED = 5.0          # sigmas


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run each row with as many seeds, and right models with ten times as many."""
    work.mkdir(parents=True, exist_ok=True)
    tasks: list[tuple[WrongModel, Scenario, int]] = [
        (row, scenario, seed) for row in ROWS for seed in range(1, runs + 1)]
    tasks += [(CLEAN, scenario, seed) for seed in range(1, CLEAN_RUNS * runs + 1)]
    names = [work / (f'wrong_{row.name.replace(" ", "_").replace("/", "_")}_'
                     f'{scenario.sha256[:16]}_{seed}.npz') for row, scenario, seed in tasks]
    complete(names, _task, tasks, on_progress=on_progress)
    live, live_note = _live(scenario, work)
    found: dict[str, list[Any]] = {}
    for name, (row, *_) in zip(names, tasks):
        with np.load(name) as arrays:
            found.setdefault(row.name, []).append(dict(arrays))
    rows = [('right' if row is CLEAN else 'wrong', *_row(row.name, found[row.name]),
             live.get(row.name, '-')) for row in (*ROWS, CLEAN)]
    worst = [f'{row.name}, seed {seed}' for row in (*ROWS, CLEAN)
             for seed, each in enumerate(found[row.name], start=1)
             if str(each['word']) == CONVERGED and np.abs(each['error'][3:]).max() > _ALLOWED]
    clean = found[CLEAN.name]
    alarms = sum(str(each['word']) in (INCONSISTENT, LOST)
                 or bool(np.isfinite(each['alarm_s'])) for each in clean)
    return Outcome(
        f'Wrong models, {runs} runs each, {len(clean)} of the right one',
        ('model', 'what is wrong', 'calibrated, sigma', 'attitude, sigma', 'NEES',
         'alarm after, s', 'converged', 'not yet', 'inconsistent', 'lost',
         'clearest statistic or change', 'live'),
        tuple(rows),
        ('Errors over stated sigmas: the largest of the calibrated states and of the attitude, '
         'median over the runs. A step or drift that was seen is answered and then counts as '
         'known: where the verdict is not inconsistent the errors are honest.',
         'converged with a calibrated state off by more than 5 sigma: '
         + ('; '.join(worst) if worst else 'in no run') + '.',
         f'False alarms: {alarms} of {len(clean)} right runs.', live_note),
        values={'false_alarms': alarms, 'right_runs': len(clean), 'confidently_wrong': worst})


def _task(row: WrongModel, scenario: Scenario, seed: int) -> dict[str, NDArray[Any]]:
    judged = wrong_models.run(row, scenario, seed)
    changes = [f'{change.kind}: {" or ".join(change.what)}'
               for change in judged.calibrator.consistency.changes]
    return {'error': judged.error, 'nees': np.array(judged.nees),
            'alarm_s': np.array(judged.alarm_s), 'word': np.array(judged.word),
            'said': np.array((*judged.failed, *changes, '')[0])}


def _live(scenario: Scenario, work: Path) -> tuple[dict[str, str], str]:
    """Return the verdicts of the live runs, and what is to be said of them."""
    scenario = scenario.replace({'simulation.duration_s': min(
        scenario.simulation.duration_s, _LIVE_S), 'simulation.real_time_factor': 0.0})
    words = {}
    for row in (row for row in ROWS if row.name in LIVE):
        folder = work / f'live_{row.name.replace(" ", "_")}'
        shutil.rmtree(folder, ignore_errors=True)       # of a study that was interrupted
        folder.mkdir()
        try:
            words[row.name] = wrong_models.live(row, scenario, folder)
        except NodeError as error:
            return words, f'No live runs: {error}.'
    return words, (f'live: the last verdict in the diagnostics of the suite run as nodes for '
                   f'{scenario.simulation.duration_s:.0f} s.')


def _row(name: str, runs: Sequence[dict[str, NDArray[Any]]]) -> tuple[str | float, ...]:
    error = np.abs(np.stack([each['error'] for each in runs]))
    words = Counter(str(each['word']) for each in runs)
    said = Counter(str(each['said']) for each in runs).most_common(1)[0][0]
    alarm = float(np.median([each['alarm_s'] for each in runs]))
    return (name, float(np.median(error[:, CALIBRATED].max(axis=-1))),
            float(np.median(error[:, PHI].max(axis=-1))),
            float(np.median([each['nees'] for each in runs])),
            alarm if np.isfinite(alarm) else 'never',
            *(words[word] for word in (CONVERGED, 'not yet', INCONSISTENT, LOST)), said or '-')
