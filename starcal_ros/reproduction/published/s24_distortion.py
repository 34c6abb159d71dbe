# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Beyond S24: when self-calibration should estimate k1, the challenge that its Sec. 5 leaves open.

f and the angles between stars against the size of k1, the centroid error, NF and NS.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.reproduction.outcome import Curve, Outcome, Panel
from starcal_ros.reproduction.self2024 import CAP, CONE, NOTES, PITCH_MM, TRUTH, Point, bound
from starcal_ros.reproduction.self2024_lens import ESTIMATORS, Case, Errors, run

RUNS = 40
K1 = (0.0, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4)
LENS = 1e-5                                     # where the others are varied
SIGMAS_PX, STARS, FRAMES = (0.01, 0.03, 0.1, 0.3), (10, 20, 40), (30, 100)
_EDGE_PX = (TRUTH[2] * np.tan(CONE + CAP))**3 / PITCH_MM        # distortion there, for k1 = 1
_SCENES = 4                                     # for the bound


def reproduce(scenario: Scenario, runs: int, work: Path,
              on_progress: Callable[[float], None]) -> Outcome:
    """Run the study."""
    seed, point = scenario.simulation.seed, Point()
    others = [*(Point(sigma_px=sigma) for sigma in SIGMAS_PX),
              *(Point(stars=stars) for stars in STARS), *(Point(frames=count) for count in FRAMES)]
    cases = list(dict.fromkeys([*(Case(point, k1) for k1 in K1),
                                *(Case(other, LENS) for other in others)]))
    results = dict(zip(cases, run(cases, runs, seed, work, on_progress)))
    limits = {other: 1e3 * bound(other, seed, 4, _SCENES)[1, 2] for other in {point, *others}}
    rows = tuple((
        f'sigma {case.point.sigma_px:g}, NF {case.point.frames}, NS {case.point.stars}', case.k1,
        case.k1 * _EDGE_PX, *errors.f_rms.tolist(), float(limits[case.point]),
        *errors.angle_rms.tolist()) for case, errors in results.items())
    return Outcome(
        f'Self-calibration with k1, {runs} rounds', (
            'point', 'k1 mm^-2', 'edge px', *(f'f um {name}' for name in ESTIMATORS), 'bound',
            *(f'angle " {name}' for name in ESTIMATORS)),
        rows, (*NOTES[:2], *_notes(results, point, others)),
        _panels(results, point, limits))


def _notes(results: dict[Case, Errors], point: Point, others: list[Point]) -> list[str]:
    """Say from which k1 on it pays to estimate it."""
    # The pinhole's f is wrong in proportion to k1, and random as without distortion.
    noise = results[Case(point, 0.0)].f_rms[0]
    slope = np.mean(results[Case(point, LENS)].f_um[0]) / LENS
    told = []
    for k, name in enumerate(ESTIMATORS[1:], start=1):
        limit = np.sqrt(max(results[Case(point, LENS)].f_rms[k]**2 - noise**2, 0.0)) / abs(slope)
        told.append(f'{limit:.1e} mm^-2 ({limit * _EDGE_PX:.2f} px at the edge of the field) for '
                    f'{name}')
    return [
        f'The pinhole moves f by {slope * 1e-6:.0f} um for each 1e-6 mm^-2 of k1, which is '
        f'{1e-6 * _EDGE_PX:.3f} px at the edge of the field. To estimate k1 pays from k1 = '
        + ' and '.join(told) + f' on, at sigma {point.sigma_px:g} px, NF {point.frames}, NS '
        f'{point.stars}; in proportion to sigma / sqrt(NF NS) elsewhere.',
        'With r held, the instruments for f and for k1 are nearly alike, and SCWC loses most of '
        'what the spots tell. SCOC less its expectation comes within a factor of 1.5 of the '
        'bound (S, the same unknowns). Plain SCOC is not shown: its bias is many times its error.']


def _panels(results: dict[Case, Errors], point: Point, limits: dict[Point, float]
            ) -> tuple[Panel, ...]:
    sweeps: tuple[tuple[str, str, Array, list[Case]], ...] = (
        ('k1', 'k1 [mm^-2]', np.array(K1[1:]), [Case(point, k1) for k1 in K1[1:]]),
        ('sigma, k1 = 1e-5', 'sigma [px]', np.array(SIGMAS_PX),
         [Case(Point(sigma_px=sigma), LENS) for sigma in SIGMAS_PX]),
        ('NS, k1 = 1e-5', 'NS', np.array(STARS, float),
         [Case(Point(stars=stars), LENS) for stars in STARS]))
    panels = []
    for what, attribute in (('error of f [um]', 'f_rms'), ('error of an angle ["]', 'angle_rms')):
        for title, axis, x, cases in sweeps:
            y = np.array([getattr(results[case], attribute) for case in cases])
            curves = [Curve(x, y[:, k], name, 'marked') for k, name in enumerate(ESTIMATORS)]
            if attribute == 'f_rms':
                curves.append(Curve(x, np.array([limits[case.point] for case in cases]),
                                    'bound with k1', 'limit'))
            panels.append(Panel(title, axis, what, tuple(curves), log='xy'))
    return tuple(panels)
