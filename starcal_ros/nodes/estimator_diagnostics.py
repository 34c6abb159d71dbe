# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The state of the estimator as diagnostic_msgs (REP-107): the calibration and its inputs."""

from __future__ import annotations

from collections.abc import Sequence
import dataclasses
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from starcal_ros.checks.check import Checked
from starcal_ros.core import verdict_words
from starcal_ros.filter import verdict
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.progress import Progress
from starcal_ros.filter.states import STATE_NAMES, STATE_UNITS, UNIT
from starcal_ros.nodes.base.matched_subscription import MatchedSubscription

_SILENCE_S = 3.0        # without a message before an input counts as silent


class Diagnostics:
    """Writes the diagnostics of one node; the names of the statuses begin with its namespace."""

    def __init__(self, node: Node, inputs: Sequence[MatchedSubscription]) -> None:
        self._node = node
        self._prefix = f'{node.get_namespace().strip("/")}/'.lstrip('/')
        self._inputs = inputs
        self._looked_s = time.monotonic()
        self._heard_s: dict[str, float] = {}        # by topic, as the next
        self._received: dict[str, int] = {}

    def message(self, calibrator: Calibrator, enabled: bool, progress: Progress | None = None,
                checked: Checked | None = None) -> DiagnosticArray:
        """Return health, counts and verdict, what is received, what its first minutes deny."""
        message = DiagnosticArray(status=[self._calibration(calibrator, enabled, progress),
                                          self._of_inputs(), self._of_check(checked)])
        message.header.stamp = self._node.get_clock().now().to_msg()
        return message

    def _calibration(self, calibrator: Calibrator, enabled: bool, progress: Progress | None
                     ) -> DiagnosticStatus:
        belief = calibrator.belief
        counts = dataclasses.asdict(calibrator.counts)
        values = {name: str(value) for name, value in counts.items()}
        values['waiting_frames'] = str(calibrator.waiting)
        if not enabled:
            return self._status('calibration', DiagnosticStatus.WARN, 'disabled', values)
        if belief is None:
            return self._status('calibration', DiagnosticStatus.WARN, 'no attitude yet', values)
        judged = verdict.of(calibrator, progress)
        values['advice'] = judged.advice or 'none'
        values['not_told_apart'] = '; '.join(
            coupling.sentence for coupling in judged.couplings) or 'none'
        numbers = {'correlation_u0_psi_y': judged.u0_psi_y,
                   'correlation_v0_psi_x': judged.v0_psi_x, 'time_to_go_s': judged.remaining_s}
        for axis, sigma, rms in zip('uv', judged.equivalent_sigma_px,
                                    calibrator.reprojection_rms_px):
            numbers[f'sigma_equivalent_principal_point_{axis}_px'] = sigma
            numbers[f'reprojection_rms_{axis}_px'] = rms
        for name, unit, sigma in zip(STATE_NAMES, STATE_UNITS, belief.sigma / UNIT):
            numbers[f'sigma_{name}'], values[f'unit_{name}'] = sigma, unit
        for state in judged.states:
            numbers[f'tolerance_{state.name}'] = state.tolerance
        for each in judged.statistics:
            key = each.name.lower().replace(' ', '_')
            numbers |= {key: each.value, f'{key}_low': each.low, f'{key}_high': each.high}
        for level in calibrator.noise.levels():
            numbers |= {f'noise_level_{level.key}': level.value,
                        f'noise_level_{level.key}_stated': level.stated}
        values['verdict'] = judged.word
        values.update({name: f'{number:.6g}' for name, number in numbers.items()})
        bad = judged.word in (verdict_words.LOST, verdict_words.INCONSISTENT)
        level = DiagnosticStatus.ERROR if bad else DiagnosticStatus.OK
        return self._status('calibration', level, judged.summary, values)

    def _of_inputs(self) -> DiagnosticStatus:
        now_s, values, troubles = time.monotonic(), {}, []
        for subscription in self._inputs:
            topic, received = subscription.topic, subscription.received
            fresh = received - self._received.get(topic, 0)
            heard_s = now_s if fresh else self._heard_s.setdefault(topic, now_s)
            if not subscription.publishers:
                troubles.append(f'{topic} has no publisher')
            elif now_s - heard_s > _SILENCE_S:
                troubles.append(f'{topic} is silent for {now_s - heard_s:.0f} s')
            values[f'{topic} publishers'] = str(subscription.publishers)
            values[f'{topic} messages'] = str(received)
            values[f'{topic} messages_per_second'] = (
                f'{fresh / max(now_s - self._looked_s, 1e-3):.1f}')
            values[f'{topic} lost_by_middleware'] = str(subscription.lost)
            self._heard_s[topic], self._received[topic] = heard_s, received
        if not self._inputs:
            troubles.append('waiting for subscribers of the results')
        self._looked_s = now_s
        level = DiagnosticStatus.WARN if troubles else DiagnosticStatus.OK
        return self._status('inputs', level, ', '.join(troubles) or 'receiving', values)

    def _of_check(self, checked: Checked | None) -> DiagnosticStatus:
        if checked is None:
            return self._status('check', DiagnosticStatus.OK, 'not yet', {})
        values = {f'{k}: {each.points_at}': each.sentence
                  for k, each in enumerate(checked.findings, start=1)}
        values['not_told'] = '; '.join(checked.untold) or 'none'
        level = DiagnosticStatus.WARN if checked.findings else DiagnosticStatus.OK
        found = ', '.join(each.kind for each in checked.findings)
        return self._status('check', level, found or 'nothing found', values)

    def _status(self, name: str, level: bytes, message: str, values: dict[str, str]
                ) -> DiagnosticStatus:
        return DiagnosticStatus(
            name=f'{self._prefix}starcal: {name}', level=level, message=message,
            hardware_id=f'{self._prefix}star_tracker',
            values=[KeyValue(key=key, value=value) for key, value in values.items()])
