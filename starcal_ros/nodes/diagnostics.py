# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The state of the estimator as diagnostic_msgs (REP-107)."""

from __future__ import annotations

import dataclasses

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np

from starcal_ros.estimator import CALIBRATED, STATE_NAMES, STATE_UNITS, UNIT, Belief
from starcal_ros.stream import Stream

_COUPLED = 0.95         # correlation above which two states can not be told apart


def diagnostics(stream: Stream, now: Time, enabled: bool) -> DiagnosticArray:
    """Return health, counts, convergence and the states that can not be told apart yet."""
    belief = stream.belief
    status = DiagnosticStatus(name='starcal: calibration', hardware_id='star_tracker')
    values = {name: str(value) for name, value in dataclasses.asdict(stream.counts).items()}
    values['waiting_frames'] = str(stream.waiting)
    if not enabled:
        status.level, status.message = DiagnosticStatus.STALE, 'disabled'
    elif belief is None:
        status.level, status.message = DiagnosticStatus.WARN, 'no attitude yet'
    else:
        wide = _wide(stream, belief)
        if not stream.tracking:
            status.level, status.message = DiagnosticStatus.ERROR, 'most stars are refused'
        elif wide:
            status.level = DiagnosticStatus.OK
            status.message = 'converging: ' + ', '.join(wide)
        else:
            status.level, status.message = DiagnosticStatus.OK, 'converged'
        values['not_told_apart'] = ', '.join(_coupled(belief)) or 'none'
        u, v = stream.reprojection_rms_px
        values['reprojection_rms_px'] = f'{u:.4f} {v:.4f}'
        for name, unit, sigma in zip(STATE_NAMES, STATE_UNITS, belief.sigma / UNIT):
            values[f'sigma_{name}'] = f'{sigma:.3g} {unit}'
    status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
    message = DiagnosticArray(status=[status])
    message.header.stamp = now
    return message


def _wide(stream: Stream, belief: Belief) -> list[str]:
    """Return the states whose sigma is still outside its tolerance."""
    outside = belief.sigma[CALIBRATED] > stream.filter.tolerance
    return [name for name, wide in zip(STATE_NAMES[CALIBRATED], outside) if wide]


def _coupled(belief: Belief) -> list[str]:
    """Return the pairs of states that are almost one."""
    sigma = belief.sigma
    correlation = belief.covariance / np.outer(sigma, sigma)
    rows, columns = np.nonzero(np.abs(np.triu(correlation, 1)) > _COUPLED)
    return [f'{STATE_NAMES[i]} and {STATE_NAMES[j]}' for i, j in zip(rows, columns)]
