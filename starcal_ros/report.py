# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a person reads: the table of states and the figure of their convergence."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from starcal_ros import rotation
from starcal_ros.calibration.predicted_centroid import History
from starcal_ros.camera import INTRINSICS_KEYS
from starcal_ros.estimator import CALIBRATED, EPSILON, UNIT
from starcal_ros.units import ARCSEC, NS

Array = NDArray[np.float64]

LABELS = ('ε_x', 'ε_y', 'ε_z', 'Ψ_x', 'Ψ_y', 'Ψ_z', 'u0', 'v0', 'f', 'k1', 'k2', 'p1', 'p2')
_ANGLE = '°, ″'         # the value in degrees, its error and sigma in arcsec
UNITS = ('°/h', '°/h', '°/h', _ANGLE, _ANGLE, _ANGLE, 'px', 'px', 'mm', 'mm⁻²', 'mm⁻⁴',
         'mm⁻¹', 'mm⁻¹')
T18_ERROR = (0.0007, 0.0002, 0.0003, 1.8, 3.3, 0.8, 0.0546, 0.0334, 2e-5, 4e-7, 7.37e-8, 4.1e-8,
             5.8e-8)
"""Errors of T18's own simulation of two hours (Table 3), in UNITS."""


class Row(NamedTuple):
    """One calibrated state, in its unit; what is not known is NaN."""

    label: str
    unit: str
    truth: float
    estimate: float
    error: float
    sigma: float


def rows(result: dict[str, Any], truth: dict[str, Any] | None) -> list[Row]:
    """Return the 13 calibrated states of a RESULT.json, against a truth.json where there is one.

    Fixed angles are in degrees, their error, the small rotation Psi away from the truth, and its
    sigma in arcsec.
    """
    estimate, error, true = _values(result), np.full(13, np.nan), np.full(13, np.nan)
    if truth is not None:
        true = _values(truth)
        error = estimate - true
        C_est, C_true = (rotation.to_matrix(np.array(side['mounting']['quaternion_xyzw']))
                         for side in (result, truth))
        error[3:6] = rotation.log(C_est @ C_true.T) / ARCSEC
    sigma = np.sqrt(np.diag(np.array(result['covariance'])))[CALIBRATED] / UNIT[CALIBRATED]
    return [Row(*row) for row in zip(LABELS, UNITS, true.tolist(), estimate.tolist(),
                                     error.tolist(), sigma.tolist())]


def _values(side: dict[str, Any]) -> Array:
    return np.array([*side['gyro_bias_deg_h'], *side['mounting']['fixed_angles_deg'],
                     *(side['intrinsics'][key] for key in INTRINSICS_KEYS)])


def table(states: Sequence[Row], title: str) -> Table:
    """Return the states as a table: truth, estimate, error, sigma, T18's error."""
    known = any(np.isfinite(row.truth) for row in states)
    out = Table(title=title)
    columns = ['state', 'unit', *(['truth'] if known else []), 'estimate',
               *(['error'] if known else []), 'sigma',
               *(['error/sigma', 'T18 error (2 h)'] if known else [])]
    for column in columns:
        out.add_column(column, justify='left' if column in ('state', 'unit') else 'right',
                       no_wrap=True)
    for row, paper in zip(states, T18_ERROR):
        cells = [row.label, row.unit]
        place = row.sigma / 3600.0 if row.unit == _ANGLE else row.sigma
        cells += [_number(row.truth, place)] if known else []
        cells += [_number(row.estimate, place)]
        cells += [f'{row.error:.2g}'] if known else []
        cells += [f'{row.sigma:.2g}']
        cells += [f'{row.error / row.sigma:+.2f}', f'{paper:.2g}'] if known else []
        out.add_row(*cells)
    return out


def summary(result: dict[str, Any]) -> str:
    """Return one sentence on what a RESULT.json rests on."""
    counts, (u, v) = result['counts'], result['reprojection_rms_px']
    return (f'{counts["frames"]} frames, {counts["stars"]} stars used, '
            f'{counts["rejected_stars"]} refused, {counts["gyro"]} gyro readings, '
            f'{counts["gyro_gaps"]} gaps, {counts["dropped_messages"]} messages dropped; '
            f'reprojection error {u:.4f}, {v:.4f} px; '
            + ('converged' if result['converged'] else 'not converged to the tolerances'))


def _number(value: float, sigma: float) -> str:
    """Return a value to a tenth of its sigma."""
    if not (np.isfinite(value) and sigma > 0.0):
        return f'{value:.6g}'
    place = int(np.floor(np.log10(sigma))) - 1
    if place < -7:
        digits = max(int(np.floor(np.log10(max(abs(value), sigma)))) - place, 0)
        return f'{value:.{digits}e}'
    return f'{value:.{max(-place, 0)}f}'


def figure(history: History, truth: dict[str, Any] | None, path: str | Path) -> None:
    """Draw the estimates as they converge, with their 3-sigma bounds, into a PNG file.

    With a truth the errors are drawn, without it the difference to the final estimate.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    minutes = (history.stamp_ns - history.stamp_ns[0]) * NS / 60.0
    error = _errors(history, truth)
    sigma = history.sigma[:, CALIBRATED] / UNIT[CALIBRATED]
    canvas = Figure(figsize=(12.0, 13.0), layout='constrained')
    FigureCanvasAgg(canvas)
    axes = canvas.subplots(5, 3, sharex=True)
    places = [*range(3), *range(3, 6), 6, 7, 8, 9, 10, 12, 13]
    for axis, column in zip(axes.flat[places], range(13)):
        axis.fill_between(minutes, -3.0 * sigma[:, column], 3.0 * sigma[:, column],
                          color='#9ecae1', label='±3 sigma', linewidth=0)
        axis.plot(minutes, error[:, column], color='#08306b', linewidth=0.9, label='error')
        axis.axhline(0.0, color='black', linewidth=0.5)
        settled = 3.0 * sigma[len(sigma) // 5, column]
        axis.set_ylim(-1.6 * settled, 1.6 * settled)
        unit = '″' if UNITS[column] == _ANGLE else UNITS[column]
        axis.set_title(f'{LABELS[column]} [{unit}]', fontsize=10)
        axis.ticklabel_format(axis='y', style='sci', scilimits=(-3, 3))
        axis.grid(alpha=0.3)
    for axis in (axes.flat[11], axes.flat[14]):
        axis.set_axis_off()
    for axis in (axes.flat[8], axes.flat[12], axes.flat[13]):
        axis.set_xlabel('time [min]')
        axis.tick_params(labelbottom=True)
    axes.flat[0].legend(loc='upper right', fontsize=8)
    against = 'truth' if truth is not None else 'final estimate'
    canvas.suptitle(f'Estimate minus {against}, with 3-sigma bounds; axes scaled to the bound at '
                    'one fifth of the run')
    canvas.savefig(path, dpi=110)


def _errors(history: History, truth: dict[str, Any] | None) -> Array:
    if truth is None:
        bias, C_sg, lens = history.bias[-1], history.C_sg[-1], history.intrinsics[-1]
    else:
        bias = np.array(truth['gyro_bias_deg_h']) * UNIT[EPSILON]
        C_sg = rotation.to_matrix(np.array(truth['mounting']['quaternion_xyzw']))
        lens = np.array([truth['intrinsics'][key] for key in INTRINSICS_KEYS])
    return np.concatenate(((history.bias - bias),
                           rotation.log(history.C_sg @ C_sg.T),
                           history.intrinsics - lens), axis=1) / UNIT[CALIBRATED]
