# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes of users, one at a time: whether ``starcal check`` names them, and what it is worth.

Each is made in a simulated recording for each run, and in one that others made, where the folder
of ``STARCAL_FOREIGN`` has it: a recording, ``config.yaml`` and ``truth.json``. Right recordings of
several instruments show how often a false alarm is raised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros.checks.check import check
from starcal_ros.config import parameter_file
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.evaluation.estimation_error import nominal
from starcal_ros.evaluation.tasks import complete
from starcal_ros.filter.belief import Nominal
from starcal_ros.recording import reader
from starcal_ros.reproduction import mistake_trial
from starcal_ros.reproduction.mistake_trial import KnownRecording
from starcal_ros.reproduction.outcome import Outcome
from starcal_ros.reproduction.user_mistakes import CLEAN, INSTRUMENTS, ROWS, Mistake
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

RUNS = 1
CLEAN_RUNS = 20         # for each run of a row, of each instrument
FOREIGN = 'STARCAL_FOREIGN'
_LONGEST_S = 600.0      # of a simulated recording
_DWELL_S = 5.0          # at most: rest tells little


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Make each mistake in as many simulated recordings, and in a foreign one."""
    work.mkdir(parents=True, exist_ok=True)
    scenario = scenario.replace({
        'simulation.duration_s': min(scenario.simulation.duration_s, _LONGEST_S),
        'motion.dwell_s': min(scenario.motion.dwell_s, _DWELL_S)})
    foreign = foreign_folder()
    places = ['simulated', *(['foreign'] if foreign else [])]
    tasks: list[tuple[str, Mistake, Scenario, int, str]] = []
    names = []
    for place in places:
        for row in ROWS:
            for seed in range(1, (runs if place == 'simulated' else 1) + 1):
                tasks.append((place, row, scenario, seed, str(foreign or '')))
                names.append(work / f'mistake_{place}_{_file(row.name)}_'
                             f'{scenario.sha256[:16]}_{seed}.npz')
    for instrument in INSTRUMENTS:
        for seed in range(1, CLEAN_RUNS * runs + 1):
            tasks.append((instrument, CLEAN, scenario, seed, ''))
            names.append(work / f'right_{_file(instrument)}_{scenario.sha256[:16]}_{seed}.npz')
    complete(names, _task, tasks, on_progress=on_progress)
    found: dict[tuple[str, str], list[Any]] = {}
    for name, (place, row, *_) in zip(names, tasks):
        with np.load(name) as arrays:
            found.setdefault((place, row.name), []).append(dict(arrays))
    rows = [(place, *_row(row, found[place, row.name])) for place in places for row in ROWS]
    alarms = {instrument: sum(bool(str(each['kinds'])) for each in found[instrument, CLEAN.name])
              for instrument in INSTRUMENTS}
    total = CLEAN_RUNS * runs * len(INSTRUMENTS)
    said = '; '.join(f'{name}: {count}' for name, count in alarms.items())
    return Outcome(
        f'Mistakes of users: {len(ROWS)}, {runs} simulated recordings each'
        + (', and a foreign one' if foreign else ''),
        ('recording', 'mistake', 'runs', 'found', 'named right', 'other names', 'value off',
         'error before, sigma', 'error after, sigma', 'verdict before', 'verdict after'),
        tuple(rows),
        ('found: anything at all; named right: the mistake itself, and no other name. value off: '
         'of the proposed value from the truth, in its stated sigma, or as a part where it states '
         'none. error: largest of a calibrated state, in its sigma, calibrated as stated and with '
         'what is proposed; what a driver must do is done to its numbers. Median over the runs; '
         '-: nothing to adopt, or no result.',
         f'False alarms: {sum(alarms.values())} of {total} right recordings ({said}).',
         'foreign: a recording that others made, with its truth.' if foreign else
         f'No foreign recording: {FOREIGN} names no folder of one.'),
        values={'false_alarms': sum(alarms.values()), 'right_runs': total})


def foreign_folder() -> Path | None:
    """Return the folder of the foreign recording, None where none is given.

    Raises
    ------
    ConfigError
        Where one is given that is not there.
    """
    given = os.environ.get(FOREIGN)
    if not given:
        return None
    folder = Path(given)
    for name in ('config.yaml', 'truth.json'):
        if not (folder / name).is_file():
            raise ConfigError(f'{FOREIGN}: {folder} has no {name}; needs a folder with a '
                              'recording, config.yaml and truth.json')
    return folder


def foreign_recording(folder: Path) -> KnownRecording:
    """Return a recording that others made, with its truth."""
    recording = reader.read(folder)
    truth = json.loads((folder / 'truth.json').read_text())
    lens = truth['camera']
    return KnownRecording(
        recording.gyro, recording.frames, parameter_file.load(folder / 'config.yaml'),
        Nominal(np.eye(3), np.array(truth['gyro_bias_rad_s']),
                rotation.to_matrix(np.array(truth['fixed_quat_xyzw'])),
                np.array([lens[key] for key in ('u0', 'v0', 'f_mm', 'k1', 'k2', 'p1', 'p2')])))


def simulated(scenario: Scenario, seed: int) -> KnownRecording:
    """Return a simulated recording, with its truth."""
    scenario = scenario.replace({'simulation.seed': seed})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    return KnownRecording(samples, frames, scenario, nominal(
        Truth.from_scenario(scenario), int(frames.stamp_ns[-1])))


def _task(place: str, row: Mistake, scenario: Scenario, seed: int, folder: str
          ) -> dict[str, NDArray[Any]]:
    if row is CLEAN or row.name == CLEAN.name:
        known = simulated(scenario.replace(dict(INSTRUMENTS[place])), seed)
        kinds = [each.kind for each in check(known.gyro, known.frames, known.scenario).findings]
        return {'kinds': np.array('; '.join(kinds))}
    known = foreign_recording(Path(folder)) if folder and place == 'foreign' else simulated(
        scenario, seed)
    judged = mistake_trial.run(row, known, seed)
    return {'kinds': np.array('; '.join(sorted({each.kind for each in judged.checked.findings}))),
            'right': np.array(judged.right), 'wrong': np.array('; '.join(judged.wrong)),
            'off': np.array(judged.off), 'before': np.array(judged.before),
            'after': np.array(judged.after), 'words': np.array(judged.words)}


def _row(row: Mistake, runs: Sequence[dict[str, NDArray[Any]]]) -> tuple[str | float, ...]:
    wrong = '; '.join(sorted({str(each['wrong']) for each in runs if str(each['wrong'])}))
    right = sum(bool(each['right']) and not str(each['wrong']) for each in runs)
    words = [sorted({str(each['words'][k]) for each in runs}) for k in (0, 1)]
    return (row.name, len(runs), sum(bool(str(each['kinds'])) for each in runs), right,
            wrong or '-', *(_median(runs, key) for key in ('off', 'before', 'after')),
            *(', '.join(said) for said in words))


def _median(runs: Sequence[dict[str, NDArray[Any]]], key: str) -> str | float:
    values = np.array([float(each[key]) for each in runs])
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else '-'


def _file(name: str) -> str:
    return ''.join(letter if letter.isalnum() else '_' for letter in name)
