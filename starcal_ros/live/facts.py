# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the views show of an estimator, worked out of what was heard of it."""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple

import numpy as np

from starcal_ros.core.arrays import Array
from starcal_ros.core.units import DEG, DEG_PER_HOUR
from starcal_ros.filter.frame_result import Counts
from starcal_ros.filter.states import N_STATES, STATE_NAMES, UNIT
from starcal_ros.live.heard import SILENT_S, Seen, as_number
from starcal_ros.report.states import LABELS, UNITS, Row, symbols

USUAL, RARE = 2.30, 9.21        # chi-square of two degrees of freedom: 68 %, 99 %
"""NIS of a star up to which a residual is nothing to speak of, and from which on it is odd."""

_ERROR = 2                      # level of diagnostics: inconsistent or lost
_LABELS = ('φ_x', 'φ_y', 'φ_z', *LABELS)
_UNITS = (*UNITS[3:6], *UNITS)
_SHOWN_UNIT = np.array([*(DEG,) * 3, *(DEG_PER_HOUR,) * 3, *(DEG,) * 3, *(1.0,) * 7])
_COUNTS = {*(count.name for count in fields(Counts)), 'waiting_frames'}


class StateFact(NamedTuple):
    """One of the 16 states.

    Attributes
    ----------
    name : str
        Out of STATE_NAMES.
    row : Row
        Its estimate and sigma, in units that a person reads.
    tolerance : float
        The largest sigma that is wanted, in the unit of the sigma; NaN where there is none.
    """

    name: str
    row: Row
    tolerance: float

    @property
    def within(self) -> bool:
        """Whether there is a tolerance, and the sigma is inside it."""
        return bool(self.row.sigma <= self.tolerance)


class BandFact(NamedTuple):
    """A test of the innovations, with the band that it keeps where the model is right."""

    name: str
    value: float
    low: float
    high: float

    @property
    def passed(self) -> bool:
        """Whether the value is in its band."""
        return self.low <= self.value <= self.high


class RateFact(NamedTuple):
    """What comes of an input: its topic, messages a second, and what the middleware lost."""

    topic: str
    per_second: float
    lost: str


def silence(seen: Seen) -> str:
    """Say that no estimator is heard, '' while one is."""
    if seen.silent_s <= SILENT_S:
        return ''
    since = f'for {seen.silent_s:.0f} s' if np.isfinite(seen.silent_s) else 'so far'
    return f'no estimator is heard {since}'


def doubt(seen: Seen) -> str:
    """Say that the sigmas are not to be believed, '' while nothing speaks against them."""
    return ('The data contradict the model: the sigmas are not to be believed.'
            if seen.level == _ERROR else '')


def states(seen: Seen) -> list[StateFact]:
    """Return the 16 states, none before the first frame."""
    if seen.state is None:
        return []
    estimate = seen.state[1:1 + N_STATES] / _SHOWN_UNIT
    sigma = seen.sigma / UNIT
    return [StateFact(name, Row(label, unit, np.nan, value, np.nan, each), tolerance)
            for name, label, unit, value, each, tolerance in zip(
                STATE_NAMES, _LABELS, _UNITS, estimate.tolist(), sigma.tolist(),
                seen.tolerances())]


def tests(seen: Seen) -> list[BandFact]:
    """Return the tests of the innovations."""
    return [BandFact(key.replace('_', ' ').replace('nis of', 'NIS of'),
                     *(seen.number(key + end) for end in ('', '_low', '_high')))
            for key in seen.values
            if f'{key}_low' in seen.values and f'{key}_high' in seen.values]


def rates(seen: Seen) -> list[RateFact]:
    """Return what comes of each input."""
    found = []
    for key, value in seen.inputs.items():
        topic, _, what = key.rpartition(' ')
        if what == 'messages_per_second':
            found.append(RateFact(topic, as_number(value),
                                  seen.inputs.get(f'{topic} lost_by_middleware', '0')))
    return found


def counts(seen: Seen) -> dict[str, str]:
    """Return the counts, by their names in words."""
    return {key.replace('_', ' '): value for key, value in seen.values.items() if key in _COUNTS}


def stamp_text(seen: Seen) -> str:
    """Return the stamp of the last frame as UTC, to the millisecond; '' before the first."""
    return '' if seen.state is None else str(np.datetime64(round(seen.state[0] * 1e3), 'ms'))


def reprojection_px(seen: Seen) -> Array | None:
    """Return what the fit leaves of the centroids, (2,) [px]; None while that is not known."""
    rms = np.array([seen.number(f'reprojection_rms_{axis}_px') for axis in 'uv'])
    return rms if np.isfinite(rms).all() else None


def verdict(seen: Seen) -> str:
    """Return the verdict as it is said, with the reasons for it."""
    return symbols(seen.message)


def advice(seen: Seen) -> str:
    """Return what would help, '' of nothing."""
    return _text(seen, 'advice')


def not_told_apart(seen: Seen) -> str:
    """Return which states can not be told apart, '' of none."""
    return _text(seen, 'not_told_apart')


def remaining_s(seen: Seen) -> float:
    """Return how long it will take at the present rate of gain [s]; NaN where not known."""
    return seen.number('time_to_go_s')


def _text(seen: Seen, key: str) -> str:
    value = seen.values.get(key, 'none')
    return '' if value == 'none' else symbols(value)
