# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The plain open-loop filter beside the one with feedback, on the same recordings.

T18 estimates the errors of values that stay as they were first believed; with feedback these are
corrected after each frame. Both are linear in the errors, but the one stays linearised at the
first values, and what it leaves out grows with the square of their errors. The first errors are
therefore made smaller as well: the nominal values are moved towards the truth, which leaves the
recordings as they are.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
from pathlib import Path

import numpy as np

from starcal_ros.config.instrument import MountingConfig
from starcal_ros.config.models import intrinsics, mounting_matrix
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.units import DEG_PER_HOUR
from starcal_ros.evaluation import consistency, montecarlo
from starcal_ros.evaluation.batch_results import Runs
from starcal_ros.evaluation.montecarlo import MonteCarlo
from starcal_ros.filter.states import N_STATES, STATE_NAMES, UNIT
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.published import table3
from starcal_ros.simulation.truth import Truth

RUNS = 20
PARTS = {'1': 1.0, '1/3': 1.0 / 3.0, '1/10': 0.1, '1/30': 1.0 / 30.0}
"""Of the first errors."""
_TANGENTIAL = [STATE_NAMES.index(name) for name in ('p1', 'p2')]
READING = ('RMS of error over stated sigma at the end: 1 of a true filter, whose NEES is 16 and '
           'whose NIS over its degrees of freedom is 1. open, 1/3: open loop, from first errors '
           'of a third of those of the scenario.')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run both filters on the same recordings, the open one from smaller first errors as well."""
    cases = {'feedback': scenario}
    cases.update({f'open, {name}': nearer(scenario, part).replace({'estimator.feedback': False})
                  for name, part in PARTS.items()})
    ends: dict[str, Runs] = {}
    for name, case in cases.items():
        ends[name], = montecarlo.run(MonteCarlo(case, runs), work)
        on_progress(len(ends) / len(cases))
    rms = np.stack([np.sqrt(np.mean((end.error / end.sigma)[:, -1]**2, axis=0))
                    for end in ends.values()])
    nees = np.array([end.nees[:, -1].mean() for end in ends.values()])
    nis = [float(end.nis.sum() / end.nis_degrees.sum()) for end in ends.values()]
    rows: list[tuple[str | float, ...]] = [
        (name, *rms[:, k].tolist()) for k, name in enumerate(STATE_NAMES)]
    rows += [('NEES', *nees.tolist()), ('NIS', *nis)]
    return Outcome(
        f'Open loop and feedback on the same data, {runs} runs', ('state', *cases), tuple(rows),
        (READING, _good_enough(nees[1:], runs), *_against_the_paper(ends['open, 1'])),
        _panels(rms, nees, runs))


def nearer(scenario: Scenario, part: float) -> Scenario:
    """Return the scenario with a part of its first errors, and with the same truth."""
    truth = Truth.from_scenario(scenario)
    lens = truth.intrinsics + part * (intrinsics(scenario.camera) - truth.intrinsics)
    psi = rotation.log(mounting_matrix(scenario.mounting) @ truth.C_sg.T)
    bias = truth.bias / DEG_PER_HOUR
    mounting = MountingConfig(quaternion_xyzw=tuple(
        rotation.to_quaternion(rotation.exp(part * psi) @ truth.C_sg).tolist()))
    return dataclasses.replace(scenario, mounting=mounting).replace({
        'camera.principal_point_px': tuple(lens[:2].tolist()),
        'camera.focal_length_mm': float(lens[2]),
        'camera.distortion': tuple(lens[3:].tolist()),
        'gyro.bias_deg_h': tuple(
            (bias + part * (np.array(scenario.gyro.bias_deg_h) - bias)).tolist())})


def _good_enough(nees: Array, runs: int) -> str:
    interval = consistency.mean_interval(N_STATES, runs, 0.95)
    good = [name for name, value in zip(PARTS, nees.tolist()) if value <= interval.high]
    return (f'A true filter has a mean NEES of {interval.low:.1f} to {interval.high:.1f} (95 %). '
            'The open loop is good enough from ' + (
                f'first errors of {good[0]} of those of the scenario on; from larger ones it is '
                'wrong by many of the sigmas that it states'
                if good else 'none of these first errors') + ', and its NIS does not tell.')


def _against_the_paper(end: Runs) -> list[str]:
    """Say what the open loop leaves of p1 and p2 if that is not what T18 has."""
    ours = (np.sqrt(np.mean(end.error[:, -1]**2, axis=0)) / UNIT)[_TANGENTIAL]
    paper = np.array(table3.PAPER)[np.array(_TANGENTIAL) - 3]
    if (ours < 10.0 * paper).any():
        return []
    return [f'From all of the first errors the open loop leaves p1 and p2 wrong by {ours[0]:.1e} '
            f'and {ours[1]:.1e} mm^-1. T18 Table 3 has {paper[0]:.1e} and {paper[1]:.1e}: its '
            'filter was linearised anew on the way, or its camera, of which T18 does not state '
            'the first values, began nearer to the truth.']


def _panels(rms: Array, nees: Array, runs: int) -> tuple[Panel, ...]:
    parts = np.array(list(PARTS.values()))
    interval = consistency.mean_interval(N_STATES, runs, 0.95)
    return (
        Panel('NEES of the 16 states', 'part of the first errors', 'NEES', (
            Curve(parts, nees[1:], 'open loop', 'marked'),
            Curve(parts[:1], nees[:1], 'feedback', 'paper'),
            Curve(parts, np.full_like(parts, interval.high), '95 % of a true filter', 'limit')),
            log='xy'),
        Panel('The worst state', 'part of the first errors', 'RMS of error over sigma', (
            Curve(parts, rms[1:].max(axis=1), 'open loop', 'marked'),
            Curve(parts[:1], rms[:1].max(axis=1), 'feedback', 'paper')), log='xy'))
