# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The report of a calibration: one page of HTML."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.config import parameter_file
from starcal_ros.config.models import detector, intrinsics
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import INTRINSICS_KEYS
from starcal_ros.core.statistic import Statistic
from starcal_ros.core.utc import utc_text
from starcal_ros.files.output import write_text
from starcal_ros.filter.ambiguity import NAMES
from starcal_ros.filter.history import History
from starcal_ros.filter.verdict import INCONSISTENT, Verdict
from starcal_ros.report import detector_charts, explanations, statistic_charts, time_charts
from starcal_ros.report.markup import charts, document, items, paragraph, section, table
from starcal_ros.report.states import (DOUBT, LABELS, SCALED, UNITS, Row, at_frame, rows, short,
                                       summary)

_LABEL = {name: name.replace('_', ' ') for name in NAMES[:3]} | dict(zip(NAMES[3:], LABELS))


class Calibration(NamedTuple):
    """All that the report is made of.

    Attributes
    ----------
    outcome : dict
        RESULT.json.
    truth : dict or None
        truth.json, where it is known.
    history : History
        How it came about.
    verdict : Verdict
        On the final estimate.
    scenario : Scenario
        Configuration that it was made with.
    notices : list of str
        What a user should know.
    tests : sequence of (int, tuple of Statistic)
        What the tests of the innovations were on the way, by their stamps.
    """

    outcome: dict[str, Any]
    truth: dict[str, Any] | None
    history: History
    verdict: Verdict
    scenario: Scenario
    notices: list[str]
    tests: Sequence[tuple[int, tuple[Statistic, ...]]] = ()


def write_page(path: str | Path, calibration: Calibration) -> None:
    """Write the report of a calibration."""
    write_text(path, html(calibration))


def html(calibration: Calibration) -> str:
    """Return the report of a calibration as HTML."""
    outcome = calibration.outcome
    title = f'Calibration of {outcome["provenance"]["bag"]}'
    return document(
        title, _verdict(calibration), _states(calibration), _noise(calibration),
        _explanations(calibration), _changes(calibration),
        _convergence(calibration),
        _residuals(calibration), _consistency(calibration), _distortion(calibration),
        _coupling(calibration), _counts(calibration), _provenance(calibration))


def _verdict(calibration: Calibration) -> str:
    verdict = calibration.verdict
    u, v = verdict.equivalent_sigma_px
    said = [
        f'u0 and Ψ_y are correlated by {verdict.u0_psi_y:+.4f}, v0 and Ψ_x by '
        f'{verdict.v0_psi_x:+.4f}. The equivalent principal point, which is what the attitude '
        f'rests on, has sigmas of {u:.2g} and {v:.2g} px.']
    for coupling in verdict.couplings:
        names = ', '.join(_LABEL.get(name, name) for name in coupling.names)
        said.append(f'{names} can not be told apart yet: {coupling.reason}; {coupling.advice}.')
    summary_ = verdict.summary
    for name in verdict.outside:
        summary_ = summary_.replace(name, _LABEL[name])
    return section(
        'verdict', 'Verdict',
        f'<p class="verdict {"yes" if verdict.converged else "no"}">'
        f'{escape(summary_[0].upper() + summary_[1:])}.</p>',
        paragraph(summary(calibration.outcome) + '.'), items(said))


def _states(calibration: Calibration) -> str:
    known, doubted = calibration.truth is not None, calibration.verdict.word == INCONSISTENT
    head = ['state', 'unit', *(['truth'] if known else []), 'estimate',
            *(['error'] if known else []), 'sigma', *([SCALED] if doubted else []),
            'tolerance', 'within',
            *(['error/sigma'] if known else [])]

    def cells(row: Row, tolerance: float, within: bool) -> list[str]:
        return [row.label, row.unit, *([row.places(row.truth)] if known else []),
                row.places(row.estimate), *([short(row.error)] if known else []),
                short(row.sigma), *([short(row.scaled)] if doubted else []),
                short(tolerance), 'yes' if within else 'no',
                *([f'{row.error / row.sigma:+.2f}'] if known else [])]

    return section(
        'states', 'States', *([paragraph(DOUBT)] if doubted else []),
        table(head, [cells(row, state.tolerance, state.within) for row, state in zip(
            rows(calibration.outcome, calibration.truth), calibration.verdict.states)]),
        paragraph('Fixed angles are in degrees, their sigma, error and tolerance in arc seconds. '
                  'Tolerances are those of the configuration, estimator.tolerance.'))


def _noise(calibration: Calibration) -> str:
    """Return the noise levels that were estimated; nothing without any."""
    found = calibration.outcome['noise_levels']
    if not found:
        return ''
    return section(
        'noise', 'Noise levels',
        table(['parameter', 'stated', 'found', 'sigma', 'used'],
              [[each['parameter'], f'{each["stated"]:.3g}', f'{each["value"]:.3g}',
                short(np.nan if each['sigma'] is None else each['sigma']),
                'yes' if each['used'] else 'no'] for each in found]),
        paragraph('Estimated from the innovations, by likelihood (estimator.adapt). They are used '
                  'where they explain the data beyond chance, the best effect taken out.'))


def _explanations(calibration: Calibration) -> str:
    """Return the extensions of the model that were tried; nothing where none were."""
    found = calibration.outcome.get('explanations')
    if found is None:
        return ''
    adopted = calibration.outcome['provenance'].get('adopted')
    what = (f'Adopted: {adopted}; all of this page is calibrated with it, and judged by the same '
            'tests.' if adopted else 'Nothing was adopted.')
    return section(
        'explanations', 'What would explain the data',
        paragraph(f'The data contradict the model as it is configured; {found["sentence"]}. '
                  f'{what}'),
        table(list(explanations.HEAD), explanations.cells(found['tried'])),
        paragraph(explanations.CRITERION.format(stretch=found['stretch_s'])))


def _changes(calibration: Calibration) -> str:
    """Return the stretches between the changes that were seen; nothing without any."""
    changes, history = calibration.outcome['changes'], calibration.history
    if not changes:
        return ''
    # The last frame before each change, and the last of all.
    ends = [max(int(np.searchsorted(history.stamp_ns, change['since_ns'])) - 1, 0)
            for change in changes if change['kind'] == 'step'] + [len(history.stamp_ns) - 1]
    stretches = [at_frame(history, row) for row in ends]
    body = [[LABELS[k], UNITS[k], *(
        f'{each.places(each.estimate)} ± {short(each.sigma)}'
        for each in (stretch[k] for stretch in stretches))] for k in range(len(LABELS))]
    head = ['state', 'unit', *(f'up to {utc_text(int(history.stamp_ns[row]))}' for row in ends)]
    return section(
        'changes', 'Changes',
        items([f'A {change["sentence"]}.' for change in changes]),
        paragraph('What was estimated up to each step, and at the end:') if ends[1:] else '',
        table(head, body) if ends[1:] else '')


def _convergence(calibration: Calibration) -> str:
    history = calibration.history
    against = 'truth' if calibration.truth is not None else 'final estimate'
    n = history.frames
    drawn = len(time_charts.thinned(len(history.stamp_ns)))
    thin = f' Of {n} frames {drawn} are drawn.' if drawn < n else ''
    return section(
        'convergence', 'Convergence',
        paragraph(f'Estimate minus {against} with 3-sigma bounds, scaled to the bound at one '
                  f'fifth of the run.{thin}'),
        charts(time_charts.convergence(history, calibration.truth)))


def _residuals(calibration: Calibration) -> str:
    stars = calibration.history.stars
    used = stars.residual[stars.accepted]
    u, v = np.sqrt(np.mean(used**2, axis=0)) if len(used) else (0.0, 0.0)
    cells, every = detector_charts.CELLS, calibration.history.every
    which = (f'all {len(used)} stars used' if every == 1 else
             f'the {len(used)} stars used of one frame in {every}')
    return section(
        'residuals', 'Residuals',
        paragraph(f'Measured minus predicted centroid after the update, of {which}: RMS '
                  f'{u:.4f}, {v:.4f} px. The map averages them over {cells} by {cells} cells of '
                  'the detector; the lines in the histograms are the Gaussian that '
                  'the stated sigmas promise.'),
        charts([detector_charts.residual_map(stars, detector(calibration.scenario.camera)),
                *detector_charts.residual_histograms(stars)]))


def _consistency(calibration: Calibration) -> str:
    figure, text = time_charts.consistency(calibration.history)
    tests, stamps = calibration.tests, calibration.history.stamp_ns
    if calibration.verdict.statistics:
        tests = [*tests, (int(stamps[-1]), calibration.verdict.statistics)]
    drawn = statistic_charts.statistics(tests, int(stamps[0]))
    failing = sum(not each.passed for each in calibration.verdict.statistics)
    told = (f'{failing} of {len(drawn)} tests of the innovations fail. ' if failing else
            f'All {len(drawn)} tests of the innovations pass. ') if drawn else (
            'There are too few frames for the tests of the innovations.')
    how = ('Each is drawn, minute by minute, by its place in the band that it keeps where the '
           'model is right, beyond it on a logarithmic scale: at 10 × it is ten half widths away '
           'from the middle.') if drawn else ''
    return section('consistency', 'Consistency', paragraph(told + how), charts(drawn),
                   paragraph(text), charts([figure]))


def _distortion(calibration: Calibration) -> str:
    pixels = detector(calibration.scenario.camera)
    before = intrinsics(calibration.scenario.camera)
    after = _camera(calibration.outcome)
    maps = [detector_charts.distortion_map('Nominal', pixels, before),
            detector_charts.distortion_map('Estimated', pixels, after)]
    if calibration.truth is not None:
        true = _camera(calibration.truth)
        maps += [
            detector_charts.distortion_map('Nominal − truth', pixels, before, true),
            detector_charts.distortion_map('Estimate − truth', pixels, after, true)]
    return section(
        'distortion', 'Distortion',
        paragraph('How far the lens moves the image of a star from where a pinhole camera has '
                  'it, before and after the calibration. Each map has its own scale.'),
        charts(maps))


def _coupling(calibration: Calibration) -> str:
    verdict = calibration.verdict
    sigma = calibration.outcome['intrinsics_sigma']
    u, v = verdict.equivalent_sigma_px
    return section(
        'coupling', 'Coupling',
        paragraph('Principal point and fixed angles move the stars almost alike (T18 Sec. 3.4). '
                  'Their common effect, the equivalent principal point, is known long before '
                  f'them: sigma {u:.2g}, {v:.2g} px, of u0 and v0 {sigma["u0_px"]:.2g}, '
                  f'{sigma["v0_px"]:.2g} px. The attitude is counted in star tracker axes.'),
        charts([detector_charts.correlation(
                    tuple(_LABEL.get(name, name) for name in verdict.names),
                    verdict.correlation),
                *time_charts.equivalent_principal_point(
                     calibration.history, calibration.truth,
                     calibration.scenario.camera.pixel_pitch_mm)]))


def _counts(calibration: Calibration) -> str:
    counts = calibration.outcome['counts']
    return section(
        'counts', 'Counts and notices',
        table([], [[name.replace('_', ' '), str(value)] for name, value in counts.items()]),
        items(calibration.notices) if calibration.notices else paragraph('No notices.'))


def _provenance(calibration: Calibration) -> str:
    provenance = calibration.outcome['provenance']
    return section(
        'provenance', 'Provenance',
        table([], [[name.replace('_', ' '), str(value)] for name, value in provenance.items()]),
        '<details><summary>Configuration</summary>'
        f'<pre>{escape(parameter_file.dump(calibration.scenario))}</pre></details>')


def _camera(side: dict[str, Any]) -> Array:
    return np.array([side['intrinsics'][key] for key in INTRINSICS_KEYS])
