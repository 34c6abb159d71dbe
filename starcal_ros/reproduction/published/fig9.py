# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""T18 Fig. 9: the equivalent principal point, and the coupling behind it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.filter.states import STATE_NAMES
from starcal_ros.filter.verdict import equivalent
from starcal_ros.reproduction import traces
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.published import BESIDE, NOT_STATED, chance
from starcal_ros.simulation.truth import Truth

RUNS = traces.RUNS
PAPER_PX = (0.0039, 0.0005)     # RMS from 1 h to 2 h
NAMES = ("du0'", "dv0'")
COUPLED = ('u0 and psi_y', 'v0 and psi_x')


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Compare the equivalent principal point with its bound."""
    trace = traces.of(scenario, runs, work, on_progress)
    truth = Truth.from_scenario(scenario)
    lens = truth.intrinsics, truth.detector.pitch_mm
    error = equivalent(trace.error[..., None], *lens)[..., 0]
    covariance = traces.bounds_of_second_half(scenario)
    limit = equivalent(np.swapaxes(equivalent(covariance, *lens), -1, -2), *lens).mean(axis=0)
    bound = np.sqrt(np.diagonal(limit)).tolist()
    squares = np.mean(error[:, trace.second_half]**2, axis=1)
    rms = np.sqrt(squares.mean(axis=0)).tolist()
    correlation, expected = trace.coupling[:, -1].mean(axis=0), traces.coupling(covariance[-1])
    rows: list[tuple[str | float, ...]] = [
        ('second half', name, 'px', PAPER_PX[k], rms[k], bound[k], rms[k] / bound[k])
        for k, name in enumerate(NAMES)]
    rows += [('correlation at the end', name, '1', '-', float(correlation[k]), float(expected[k]),
              float(correlation[k] / expected[k])) for k, name in enumerate(COUPLED)]
    least, most = np.sqrt(squares).min(axis=0), np.sqrt(squares).max(axis=0)
    one_run = ('The numbers of T18 are of one run, whose errors hang together over the hour. Of '
               f'our runs, each alone, {NAMES[0]} has {least[0]:.4f} to {most[0]:.4f} px, '
               f'{NAMES[1]} {least[1]:.4f} to {most[1]:.4f} px.')
    return Outcome(
        f'T18 Fig. 9, equivalent principal point; drawn: one run, table: RMS of {runs}', BESIDE,
        tuple(rows), (NOT_STATED, one_run, chance(runs)),
        (*_errors(trace, error[0]), *_couplings(trace)))


def _errors(trace: traces.Traces, error: Array) -> list[Panel]:
    minutes, sigma = trace.time / 60.0, trace.equivalent_sigma[0]
    panels = []
    for k, (name, part) in enumerate(zip(NAMES, ('u0', 'v0'))):
        settled = 5.0 * float(sigma[len(minutes) // 5, k])
        panels.append(Panel(f'{name}, one run', 'time [min]', 'estimate minus truth [px]', (
            Curve(minutes, np.zeros_like(minutes), '0 ± 3 sigma', 'limit', 3.0 * sigma[:, k]),
            Curve(minutes, trace.error[0, :, STATE_NAMES.index(part)], f'd{part} alone'),
            Curve(minutes, error[:, k], name)), y_limits=(-4.0 * settled, 4.0 * settled)))
    return panels


def _couplings(trace: traces.Traces) -> list[Panel]:
    minutes = trace.time / 60.0
    return [Panel(f'Correlation of {name}', 'time [min]', 'correlation', (
        Curve(minutes, trace.coupling[0, :, k]),)) for k, name in enumerate(COUPLED)]
