# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The verdict on a camera that is calibrated alone, as diagnostic_msgs (REP-107)."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from starcal_ros.calibration.camera_verdict import CameraVerdict
from starcal_ros.core.camera import INTRINSICS_KEYS
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.core.verdict_words import INCONSISTENT
from starcal_ros.nodes.base.stamps import status_stamp


def message(node: Node, estimate: CameraEstimate | None, judged: CameraVerdict | None,
            newest_ns: int = 0) -> DiagnosticArray:
    """Return verdict, counts, sigmas and each test; WARN while there is no camera."""
    prefix = f'{node.get_namespace().strip("/")}/'.lstrip('/')
    values: dict[str, str] = {}
    level, text = DiagnosticStatus.WARN, 'no camera yet'
    if estimate is not None and judged is not None:
        found = judged.consistency
        numbers = {f'sigma_{key}': sigma
                   for key, sigma in zip(INTRINSICS_KEYS, estimate.sigma.tolist())}
        numbers |= {f'tolerance_{key}': value for key, value in judged.tolerance.items()}
        numbers |= {f'variance_factor_{key}': factor
                    for key, factor in zip(INTRINSICS_KEYS, found.camera_factors)}
        if found.centroid_factor is not None:
            numbers['variance_factor_centroids'] = found.centroid_factor
        for each in found.statistics:
            key = each.name.lower().replace(' ', '_')
            numbers |= {key: each.value, f'{key}_low': each.low, f'{key}_high': each.high}
        values = {'verdict': judged.word, 'advice': judged.advice, 'frames': str(estimate.frames),
                  'stars': str(estimate.stars),
                  **{name: f'{number:.6g}' for name, number in numbers.items()}}
        level = (DiagnosticStatus.ERROR if judged.word == INCONSISTENT else DiagnosticStatus.OK)
        text = judged.summary
    out = DiagnosticArray(status=[DiagnosticStatus(
        name=f'{prefix}starcal: intrinsics', level=level, message=text,
        hardware_id=f'{prefix}star_tracker',
        values=[KeyValue(key=key, value=value) for key, value in values.items()])])
    out.header.stamp = status_stamp(node, newest_ns)
    return out
