# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The sections of the report of a calibration that are words and tables."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from starcal_ros.config import parameter_file
from starcal_ros.core.utc import utc_text
from starcal_ros.filter.ambiguity import NAMES
from starcal_ros.core.verdict_words import INCONSISTENT
from starcal_ros.report import explanations
from starcal_ros.report.calibration import NOMINAL, Calibration
from starcal_ros.report.markup import PageSection, items, paragraph, section, table
from starcal_ros.report.states import (DOUBT, LABELS, SCALED, SIGMA_UNITS, UNITS, Row, at_frame,
                                       rows, short, summary, symbols)

LABEL = {name: name.replace('_', ' ') for name in NAMES[:3]} | dict(zip(NAMES[3:], LABELS))
"""How states are called on the page, by their names."""

_FAR = 3.5              # times what is to be expected


def verdict(calibration: Calibration) -> list[PageSection]:
    """Return the verdict, and what can not be told apart yet."""
    judged = calibration.verdict
    u, v = judged.equivalent_sigma_px
    said = [
        f'u0 and Ψ_y are correlated by {judged.u0_psi_y:+.4f}, v0 and Ψ_x by '
        f'{judged.v0_psi_x:+.4f}. The equivalent principal point, which is what the attitude '
        f'rests on, has sigmas of {u:.2g} and {v:.2g} px.']
    for coupling in judged.couplings:
        names = ', '.join(LABEL.get(name, name) for name in coupling.names)
        said.append(f'{names} can not be told apart yet: {coupling.reason}; {coupling.advice}.')
    summary_ = symbols(judged.summary)
    return [section(
        'verdict', 'Verdict',
        f'<p class="verdict {"yes" if judged.converged else "no"}">'
        f'{escape(summary_[0].upper() + summary_[1:])}.</p>',
        paragraph(summary(calibration.outcome) + '.'), items(said))]


def states(calibration: Calibration) -> list[PageSection]:
    """Return the calibrated states."""
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

    return [section(
        'states', 'States', *([paragraph(DOUBT)] if doubted else []),
        table(head, [cells(row, state.tolerance, state.within) for row, state in zip(
            rows(calibration.outcome, calibration.truth), calibration.verdict.states)]),
        paragraph('Fixed angles are in degrees, their sigma, error and tolerance in arc seconds. '
                  'Tolerances are those of the configuration, estimator.tolerance.'))]


def noise(calibration: Calibration) -> list[PageSection]:
    """Return the noise levels that were estimated; nothing without any."""
    found = calibration.outcome['noise_levels']
    if not found:
        return []
    return [section(
        'noise', 'Noise levels',
        table(['parameter', 'stated', 'found', 'sigma', 'used'],
              [[each['parameter'], f'{each["stated"]:.3g}', f'{each["value"]:.3g}',
                short(np.nan if each['sigma'] is None else each['sigma']),
                'yes' if each['used'] else 'no'] for each in found]),
        paragraph('Estimated from the innovations, by likelihood (estimator.adapt). They are used '
                  'where they explain the data beyond chance, the best effect taken out.'))]


def change(calibration: Calibration) -> list[PageSection]:
    """Return what was found beside what the calibration began with."""
    began = calibration.outcome['provenance'].get('began_with', NOMINAL)
    differ, prior = calibration.change, calibration.prior_sigma
    sigma = np.array([row.sigma for row in rows(calibration.outcome, None)])
    # What data of its own can move a state by, where the model is right.
    expected = np.sqrt(np.maximum(prior**2 - sigma**2, 0.0))
    body = [[label, unit, short(d), short(p), short(s), f'{d / e:+.2f}' if e > 0.0 else '']
            for label, unit, d, p, s, e in zip(
                LABELS, SIGMA_UNITS, differ, prior, sigma, expected)]
    far = [row[0] for row in body if row[-1] and abs(float(row[-1])) > _FAR]
    return [section(
        'change', 'What has changed',
        paragraph(f'Found less {began}, with the sigmas before and after. In the last column the '
                  'change is divided by what the two sigmas let expect, the root of the '
                  'difference of their squares.'),
        paragraph(f'Farther than {_FAR:g}: {", ".join(far)}. What it began with was not as good '
                  'as it was said to be.') if far else '',
        table(['state', 'unit', 'change', 'sigma before', 'sigma now', 'change/expected'], body))]


def tried(calibration: Calibration) -> list[PageSection]:
    """Return the extensions of the model that were tried; nothing where none were."""
    found = calibration.outcome.get('explanations')
    if found is None:
        return []
    adopted = calibration.outcome['provenance'].get('adopted')
    what = (f'Adopted: {adopted}; all of this page is calibrated with it, and judged by the same '
            'tests.' if adopted else 'Nothing was adopted.')
    return [section(
        'explanations', 'What would explain the data',
        paragraph(f'The data contradict the model as it is configured; {found["sentence"]}. '
                  f'{what}'),
        table(list(explanations.HEAD), explanations.cells(found['tried'])),
        paragraph(explanations.CRITERION.format(stretch=found['stretch_s'])))]


def steps(calibration: Calibration) -> list[PageSection]:
    """Return the stretches between the changes that were seen; nothing without any."""
    changes, history = calibration.outcome['changes'], calibration.history
    if not changes:
        return []
    # The last frame before each change, and the last of all.
    ends = [max(int(np.searchsorted(history.stamp_ns, change['since_ns'])) - 1, 0)
            for change in changes if change['kind'] == 'step'] + [len(history.stamp_ns) - 1]
    stretches = [at_frame(history, row) for row in ends]
    body = [[LABELS[k], UNITS[k], *(
        f'{each.places(each.estimate)} ± {short(each.sigma)}'
        for each in (stretch[k] for stretch in stretches))] for k in range(len(LABELS))]
    head = ['state', 'unit', *(f'up to {utc_text(int(history.stamp_ns[row]))}' for row in ends)]
    return [section(
        'steps', 'Steps and drifts',
        items([f'A {change["sentence"]}.' for change in changes]),
        paragraph('What was estimated up to each step, and at the end:') if ends[1:] else '',
        table(head, body) if ends[1:] else '')]


def counts(calibration: Calibration) -> list[PageSection]:
    """Return the counts and the notices."""
    return [section(
        'counts', 'Counts and notices',
        table([], _named(calibration.outcome['counts'])),
        items(calibration.notices) if calibration.notices else paragraph('No notices.'))]


def provenance(calibration: Calibration) -> list[PageSection]:
    """Return where the result comes from."""
    return [section(
        'provenance', 'Provenance',
        table([], _named(calibration.outcome['provenance'])),
        '<details><summary>Configuration</summary>'
        f'<pre>{escape(parameter_file.dump(calibration.scenario))}</pre></details>')]


def _named(values: dict[str, Any]) -> list[list[str]]:
    return [[name.replace('_', ' '), str(value)] for name, value in values.items()]
