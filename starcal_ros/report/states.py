# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The calibrated states of a RESULT.json, against the truth where it is known."""

from __future__ import annotations

from collections.abc import Sequence
import re
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rich.table import Table

from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import INTRINSICS_KEYS
from starcal_ros.core.units import ARCSEC
from starcal_ros.files.foreign import literal
from starcal_ros.filter.states import CALIBRATED, EPSILON, UNIT
from starcal_ros.core.verdict_words import INCONSISTENT

if TYPE_CHECKING:
    from starcal_ros.filter.history import History

LABELS = ('ε_x', 'ε_y', 'ε_z', 'Ψ_x', 'Ψ_y', 'Ψ_z', 'u0', 'v0', 'f', 'k1', 'k2', 'p1', 'p2')
_SYMBOLS = {'phi': 'φ', 'epsilon': 'ε', 'psi': 'Ψ'}
_ANGLE = '°, ″'         # the value in degrees, its error and sigma in arcsec
UNITS = ('°/h', '°/h', '°/h', _ANGLE, _ANGLE, _ANGLE, 'px', 'px', 'mm', 'mm⁻²', 'mm⁻⁴',
         'mm⁻¹', 'mm⁻¹')
SIGMA_UNITS = tuple('″' if unit == _ANGLE else unit for unit in UNITS)
T18_ERROR = (0.0007, 0.0002, 0.0003, 1.8, 3.3, 0.8, 0.0546, 0.0334, 2e-5, 4e-7, 7.37e-8, 4.1e-8,
             5.8e-8)
"""Errors of T18's own simulation of two hours (Table 3), in SIGMA_UNITS."""
T18_TRUTH = (0.01, 0.01, 0.01, -0.1, 30.0, -0.2, 5.0, 10.0, 25.6, 2e-4, -1e-6, 2e-5, 2e-5)
"""What they are errors of (T18 Table 1), in UNITS."""

SCALED = 'scaled sigma'
DOUBT = ('The data contradict the model: the sigmas are not to be believed. Scaled, they have the '
         'scatter that was found in place of the one that was stated; a bias they do not show.')
"""What is said beside scaled sigmas."""


class Row(NamedTuple):
    """One calibrated state, in its unit; what is not known is NaN.

    `scaled` is the sigma that the residuals have instead where the data contradict the model.
    """

    label: str
    unit: str
    truth: float
    estimate: float
    error: float
    sigma: float
    scaled: float = np.nan

    def places(self, value: float) -> str:
        """Return truth or estimate to a tenth of sigma."""
        return _number(value, self.sigma / 3600.0 if self.unit == _ANGLE else self.sigma)


def symbols(text: str) -> str:
    """Return a sentence with the states called as `LABELS` has them, in place of their names."""
    return re.sub(r'\b(phi|epsilon|psi)(?=_[xyz]\b)', lambda name: _SYMBOLS[name[0]], text)


def rows(result: dict[str, Any], truth: dict[str, Any] | None) -> list[Row]:
    """Return the 13 calibrated states of a RESULT.json, against a truth.json where there is one.

    Fixed angles are in degrees, their error, the small rotation Psi away from the truth, and its
    sigma in arcsec.
    """
    estimate = _values(result)
    error: Array = np.full(13, np.nan)
    true: Array = np.full(13, np.nan)
    if truth is not None:
        true = _values(truth)
        error = estimate - true
        C_est, C_true = (rotation.to_matrix(np.array(side['mounting']['quaternion_xyzw']))
                         for side in (result, truth))
        error[3:6] = rotation.log(C_est @ C_true.T) / ARCSEC
    sigma = np.sqrt(np.diag(np.array(result['covariance'])))[CALIBRATED] / UNIT[CALIBRATED]
    return [Row(*row) for row in zip(LABELS, UNITS, true.tolist(), estimate.tolist(),
                                     error.tolist(), sigma.tolist(),
                                     (sigma * _scale(result)).tolist())]


def at_frame(history: History, row: int) -> list[Row]:
    """Return the 13 calibrated states after a frame of a history."""
    values = [*(history.bias[row] / UNIT[EPSILON]),
              *np.degrees(rotation.to_fixed_angles(history.C_sg[row])), *history.intrinsics[row]]
    sigma = history.sigma[row][CALIBRATED] / UNIT[CALIBRATED]
    return [Row(label, unit, np.nan, float(value), np.nan, float(each))
            for label, unit, value, each in zip(LABELS, UNITS, values, sigma)]


def _scale(result: dict[str, Any]) -> Array:
    """Return by how much to scale each sigma, (13,); NaN where they are to be believed.

    Bias and fixed angles go by the variance of the turns, the camera by that of the centroids.
    """
    if result['verdict'] != INCONSISTENT:
        return np.full(13, np.nan)
    factor = result['variance_factor']
    return np.sqrt(np.maximum(1.0, np.repeat([factor['turns'], factor['centroids']], (6, 7))))


def _values(side: dict[str, Any]) -> Array:
    return np.array([*side['gyro_bias_deg_h'], *side['mounting']['fixed_angles_deg'],
                     *(side['intrinsics'][key] for key in INTRINSICS_KEYS)])


def table(states: Sequence[Row], title: str) -> Table:
    """Return the states as a table: truth, estimate, error, sigma.

    Of the instrument of T18 it has T18's own errors as well. Where the data contradict the model
    it says that the sigmas are not to be believed, and has them scaled beside.
    """
    known = any(np.isfinite(row.truth) for row in states)
    doubted = any(np.isfinite(row.scaled) for row in states)
    papers = known and bool(np.allclose([row.truth for row in states], T18_TRUTH, 1e-9, 0.0))
    out = Table(title=literal(title), caption=DOUBT if doubted else None)
    columns = ['state', 'unit', *(['truth'] if known else []), 'estimate',
               *(['error'] if known else []), 'sigma', *([SCALED] if doubted else []),
               *(['error/sigma'] if known else []), *(['T18 error (2 h)'] if papers else [])]
    for column in columns:
        out.add_column(column, justify='left' if column in ('state', 'unit') else 'right',
                       overflow='fold')
    for row, paper in zip(states, T18_ERROR):
        cells = [row.label, row.unit]
        cells += [row.places(row.truth)] if known else []
        cells += [row.places(row.estimate)]
        cells += [short(row.error)] if known else []
        cells += [short(row.sigma)]
        cells += [short(row.scaled)] if doubted else []
        cells += [f'{row.error / row.sigma:+.2f}'] if known else []
        cells += [f'{paper:.2g}'] if papers else []
        out.add_row(*cells)
    return out


_WORDS = {
    'not yet': 'not converged to the tolerances',
    'inconsistent': 'inconsistent, the sigmas are not to be believed: turns have {turns:.3g} '
    'times the variance that they should have, centroids {centroids:.3g} times'}


def summary(result: dict[str, Any]) -> str:
    """Return one sentence on what a RESULT.json rests on."""
    counts, (u, v) = result['counts'], result['reprojection_rms_px']
    return (f'{counts["frames"]} frames, {counts["stars"]} stars used, '
            f'{counts["rejected_stars"]} rejected, {counts["gyro"]} gyro readings, '
            f'{counts["gyro_gaps"]} gaps, {counts["dropped_messages"]} messages dropped; '
            f'reprojection error {u:.4f}, {v:.4f} px; '
            + _WORDS.get(result['verdict'], result['verdict']).format(
                **result['variance_factor']))


def short(value: float) -> str:
    """Return a number to two digits, in full where it is longer than that."""
    return f'{value + 0.0:.0f}' if abs(value) >= 99.5 else f'{value + 0.0:.2g}'


def _number(value: float, sigma: float) -> str:
    """Return a value to a tenth of its sigma."""
    if not (np.isfinite(value) and sigma > 0.0):
        return f'{value:.6g}'
    place = int(np.floor(np.log10(sigma))) - 1
    if place < -7:
        digits = max(int(np.floor(np.log10(max(abs(value), sigma)))) - place, 0)
        return f'{value:.{digits}e}'
    # What rounds to nothing has no sign.
    return f'{round(value, max(-place, 0)) + 0.0:.{max(-place, 0)}f}'


def errors(history: History, truth: dict[str, Any] | None) -> Array:
    """Return estimate minus truth, (n, 13), at each frame, in the unit of sigma.

    Without a truth it is the difference to the final estimate.
    """
    if truth is None:
        bias, C_sg, lens = history.bias[-1], history.C_sg[-1], history.intrinsics[-1]
    else:
        bias = np.array(truth['gyro_bias_deg_h']) * UNIT[EPSILON]
        C_sg = rotation.to_matrix(np.array(truth['mounting']['quaternion_xyzw']))
        lens = np.array([truth['intrinsics'][key] for key in INTRINSICS_KEYS])
    return np.concatenate(((history.bias - bias),
                           rotation.log(history.C_sg @ C_sg.T),
                           history.intrinsics - lens), axis=1) / UNIT[CALIBRATED]
