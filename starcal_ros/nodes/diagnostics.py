# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The state of the estimator as diagnostic_msgs (REP-107)."""

from __future__ import annotations

import dataclasses

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from starcal_ros import verdict
from starcal_ros.estimator import PHI, STATE_NAMES, STATE_UNITS, UNIT
from starcal_ros.stream import Stream


def diagnostics(stream: Stream, now: Time, enabled: bool) -> DiagnosticArray:
    """Return health, counts and the verdict on the calibration."""
    belief = stream.belief
    status = DiagnosticStatus(name='starcal: calibration', hardware_id='star_tracker')
    values = {name: str(value) for name, value in dataclasses.asdict(stream.counts).items()}
    values['waiting_frames'] = str(stream.waiting)
    if not enabled:
        status.level, status.message = DiagnosticStatus.STALE, 'disabled'
    elif belief is None:
        status.level, status.message = DiagnosticStatus.WARN, 'no attitude yet'
    else:
        judged = verdict.judge(stream.filter, belief, stream.tracking)
        status.level = DiagnosticStatus.OK if stream.tracking else DiagnosticStatus.ERROR
        status.message = judged.summary
        values['not_told_apart'] = '; '.join(
            f'{", ".join(coupling.names)}: {verdict.advice(coupling.axis)}'
            for coupling in judged.couplings) or 'none'
        values['correlation_u0_psi_y'] = f'{judged.u0_psi_y:.4f}'
        values['correlation_v0_psi_x'] = f'{judged.v0_psi_x:.4f}'
        u, v = judged.equivalent_sigma_px
        values['sigma_equivalent_principal_point_px'] = f'{u:.3g} {v:.3g}'
        u, v = stream.reprojection_rms_px
        values['reprojection_rms_px'] = f'{u:.4f} {v:.4f}'
        for name, unit, sigma in zip(STATE_NAMES[PHI], STATE_UNITS[PHI],
                                     belief.sigma[PHI] / UNIT[PHI]):
            values[f'sigma_{name}'] = f'{sigma:.3g} {unit}'
        for state in judged.states:
            values[f'sigma_{state.name}'] = (
                f'{state.sigma:.3g} {state.unit}, tolerance {state.tolerance:.3g}')
    status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
    message = DiagnosticArray(status=[status])
    message.header.stamp = now
    return message
