# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""One moment of a calibration as JSON, for the page that `server` serves.

The page draws and says what stands here, and works out nothing: numbers as a person reads them
are texts, what is drawn is a number, and what is not known is null.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from starcal_ros.files.foreign import clean
from starcal_ros.filter.advice import advised_axis
from starcal_ros.filter.states import CALIBRATED
from starcal_ros.core.verdict_words import CONVERGED
from starcal_ros.filter.verdict import time_text
from starcal_ros.live import facts
from starcal_ros.live.heard import Seen
from starcal_ros.report.states import SIGMA_UNITS, short
from starcal_ros.report.statistic_charts import place

_KINDS = ('good', 'warning', 'bad', 'gone')     # by the level of diagnostics
_MOST_STARS = 2000                              # that a browser draws in no time


def encoded(seen: Seen) -> bytes:
    """Return the moment as one line of JSON."""
    return json.dumps(picture(seen), allow_nan=False, separators=(',', ':')).encode()


def picture(seen: Seen) -> dict[str, Any]:
    """Return the moment as what JSON has.

    Parameters
    ----------
    seen : Seen

    Returns
    -------
    dict
        ``verdict``: its `word`, the rest of its `text`, of what `kind` it is; ``doubt``, what is
        wrong with the sigmas, ``advice``, ``axis`` to turn about, ``time_to_go``,
        ``not_told_apart``: texts, empty of nothing; ``stamp``: of the last frame; ``states``,
        ``tests``, ``rates``, ``counts``: lists; ``detector``: its size; ``stars``: rows of u, v,
        du, dv [px], NIS, 1 where used, and whether the residual is usual (0), larger (1) or odd
        (2); ``reprojection``: a text.
    """
    advice, rms = facts.advice(seen), facts.reprojection_px(seen)
    remaining_s = facts.remaining_s(seen)
    return {
        'verdict': _verdict(seen),
        'doubt': facts.doubt(seen),
        'advice': clean(advice), 'axis': advised_axis(advice),
        'time_to_go': time_text(remaining_s) if remaining_s > 0.0 else '',
        'not_told_apart': clean(facts.not_told_apart(seen)),
        'stamp': facts.stamp_text(seen),
        'states': _states(seen), 'tests': _tests(seen),
        'rates': [{'topic': clean(rate.topic), 'hz': f'{rate.per_second:.1f}',
                   'lost': clean(rate.lost)} for rate in facts.rates(seen)],
        'inputs': clean(seen.inputs_message), 'counts': [
            [name, clean(value)] for name, value in facts.counts(seen).items()],
        'detector': list(seen.size) if seen.size else None, 'stars': _stars(seen),
        'reprojection': '' if rms is None else '{:.4f}, {:.4f} px'.format(*rms),
    }


def _verdict(seen: Seen) -> dict[str, str]:
    if silence := facts.silence(seen):
        return {'word': 'silence', 'text': silence, 'kind': 'gone'}
    word, _, rest = facts.verdict(seen).partition(':')
    kind = _KINDS[min(seen.level, 3)]
    if kind == 'good' and seen.message != CONVERGED:
        kind = 'open'       # nothing to complain of, and not there yet
    return {'word': clean(word), 'text': clean(rest.strip()), 'kind': kind}


def _states(seen: Seen) -> list[dict[str, Any]]:
    return [{'name': state.name, 'label': state.row.label, 'unit': unit,
             'estimate': state.row.places(state.row.estimate),
             'of': state.row.unit.partition(',')[0],
             'sigma': short(state.row.sigma),
             'tolerance': short(state.tolerance) if np.isfinite(state.tolerance) else '',
             'ratio': _finite(state.row.sigma / state.tolerance), 'within': state.within}
            for state, unit in zip(facts.states(seen)[CALIBRATED], SIGMA_UNITS)]


def _tests(seen: Seen) -> list[dict[str, Any]]:
    return [{'name': clean(test.name), 'value': f'{test.value:.4g}', 'low': f'{test.low:.4g}',
             'high': f'{test.high:.4g}', 'passed': test.passed,
             'place': _finite(float(place(*np.array([test.value, test.low, test.high]))))}
            for test in facts.tests(seen) if test.low < test.high]


def _stars(seen: Seen) -> list[list[float]] | None:
    stars = seen.stars
    if stars is None:
        return None
    rows = np.stack([np.asarray(stars[name], np.float64)
                     for name in ('u', 'v', 'du', 'dv', 'nis', 'accepted')], axis=-1)
    rows = np.round(rows[np.isfinite(rows).all(axis=-1)][:_MOST_STARS], 4)
    how = np.searchsorted([facts.USUAL, facts.RARE], rows[:, 4])
    found: list[list[float]] = np.column_stack((rows, how)).tolist()
    return found


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
