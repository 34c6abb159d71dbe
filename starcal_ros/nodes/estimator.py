# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `estimator`: gyro readings and star centroids in, calibration and attitude out."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from std_srvs.srv import SetBool, Trigger

from starcal_ros import __version__
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import distributions
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.progress import Progress
from starcal_ros.messages import cdr_imu, cdr_pointcloud, topics
from starcal_ros.messages.cdr import frame_id
from starcal_ros.messages.conventions import GYRO_FRAME, OPTICAL_FRAME
from starcal_ros.nodes.base import parameters, run_loop
from starcal_ros.nodes.base.decoding import decoded
from starcal_ros.nodes.base.managed_node import ManagedNode
from starcal_ros.nodes.base.stamps import status_stamp
from starcal_ros.nodes.estimator_check import FirstMinutes
from starcal_ros.nodes.estimator_diagnostics import Diagnostics
from starcal_ros.nodes.estimator_results import Results
from starcal_ros.results import initial, result
from starcal_ros.results.document import CalibrationError
from starcal_ros.results.store import CalibrationStore, StoreError

_DIAGNOSTICS_S = 1.0
_FIRST_S = 0.25         # for those who listen already to be found


class Estimator(ManagedNode):
    """Feed a `Calibrator` from two topics and publish what it gives."""

    def __init__(self, **options: Any) -> None:
        super().__init__('estimator', 'camera', 'mounting', 'gyro', 'star_tracker', 'observer',
                         'estimator', **options)
        parameters.follow(self, self.scenario, self._change)
        self._calibrator: Calibrator | None = None
        self.start()

    # Lifecycle

    def configure(self) -> None:
        """Prepare the calibration, its publishers and services."""
        self._archive = CalibrationStore(Path(self.scenario.estimator.calibration_directory)
                                         / self.get_namespace().strip('/'))
        self._enabled = True
        self._frames_seen: dict[topics.Topic, str | None] = {}
        self._begin()
        self._results = Results(self)
        self._servers = [
            self.serve(Trigger, '~/save_calibration', self._save),
            self.serve(Trigger, '~/undo_save', self._undo),
            self.serve(Trigger, '~/reset', self._reset),
            self.serve(SetBool, '~/set_enabled', self._set_enabled)]

    def activate(self) -> None:
        """Listen to the sensors, as soon as the results have the listeners they must have."""
        distributions.load()
        self._diagnostics = Diagnostics(self, self.inputs)
        self.repeat(_DIAGNOSTICS_S, self._publish_diagnostics, _FIRST_S)
        own = self.scenario.estimator
        self.when_heard(own.wait_for_subscribers, own.wait_for_nodes, self._listen)

    def _listen(self) -> None:
        # A few readings together take hardly longer than one.
        self.listen(topics.IMU, self._on_gyro, gather_s=self._results.rhythm.gather_s,
                    hurried=self._awaits_gyro)
        self.listen(topics.CENTROIDS, self._on_frames)

    def _awaits_gyro(self) -> bool:
        """Tell whether a frame waits for a reading that may have come."""
        frame_ns = self._calibrator.next_frame_ns
        return frame_ns is not None and self._results.rhythm.may_have_come(frame_ns)

    def deactivate(self) -> None:
        """Say where the calibration stands."""
        self._publish_diagnostics()

    def cleanup(self) -> None:
        """Forget the calibration."""
        for server in self._servers:
            self.destroy_service(server)
        self._calibrator = None

    def recover(self) -> None:
        """Go on from what was believed before an error."""
        self._calibrator.resume()

    # Messages

    def _on_gyro(self, batch: list[bytes]) -> None:
        if self._enabled:
            self._look_at_frame(topics.IMU, batch[0], GYRO_FRAME)
            for part in decoded(batch, cdr_imu.decode_imu, self._drop):
                self._results.rhythm.heard(part.stamp_ns)
                self._calibrator.add_gyro(part)
                self._first.add_gyro(part)
            self._advance()

    def _on_frames(self, batch: list[bytes]) -> None:
        if self._enabled:
            self._look_at_frame(topics.CENTROIDS, batch[0], OPTICAL_FRAME)
            for part in decoded(batch, cdr_pointcloud.decode_centroids, self._drop):
                self._calibrator.add_frames(part)
                self._first.add_frames(part)
            self._advance()

    def _look_at_frame(self, topic: topics.Topic, message: bytes, expected: str) -> None:
        found = frame_id(message)
        if found not in (None, expected, self._frames_seen.get(topic)):
            self._frames_seen[topic] = found
            self.get_logger().warning(
                f'{topic.name} has frame_id {found!r}, where {expected!r} is expected: taken for '
                'that; the rates must be about the axes of g that mounting turns to the star '
                'tracker' if topic is topics.IMU else
                f'{topic.name} has frame_id {found!r}, where {expected!r} is expected: taken for '
                'that; u must count columns to the right and v rows downwards')

    def _drop(self, why: str) -> None:
        self._calibrator.counts.dropped_messages += 1
        self.faults.alike(why)

    def _advance(self) -> None:
        """Publish what the calibrator gives by now."""
        calibrator = self._calibrator
        for frame in calibrator.process(tracked=True):
            self._results.publish_frame(calibrator, frame)
            self._progress.add(frame.stamp_ns, frame.belief.sigma)
        self._results.publish_track(calibrator, calibrator.track())
        self._first.restarted(calibrator.counts.restarts)
        for text in calibrator.take_notices():
            self.get_logger().warning(text)

    def _publish_diagnostics(self) -> None:
        for finding in self._first.take():
            self.get_logger().warning(f'{finding.points_at}: {finding.sentence}')
        message = self._diagnostics.message(self._calibrator, self._enabled, self._progress,
                                            self._first.checked)
        message.header.stamp = status_stamp(self, self._calibrator.stamp_ns)
        self._results.publish_diagnostics(message)

    # Services and parameters

    def _begin(self) -> None:
        self._start = initial.initial_values(self.scenario, self._archive)
        self._calibrator = Calibrator(self._start.scenario, self._start.covariance)
        self._progress, self._first = Progress(), FirstMinutes(self._start.scenario)
        for text in self._start.notices:
            self.get_logger().warning(text)

    def _save(self, _: Any) -> tuple[bool, str]:
        try:
            outcome = result.result(self._calibrator, {
                'version': __version__, 'config_sha256': self.scenario.sha256,
                'saved_utc': datetime.now(timezone.utc).isoformat(timespec='seconds'),
                'began_with': self._start.source or 'nominal values'}, self._progress)
            folder = self._archive.save(initial.files(outcome, self.scenario))
        except (CalibrationError, StoreError) as error:
            return False, str(error)
        return True, f'saved as {folder}'

    def _undo(self, _: Any) -> tuple[bool, str]:
        try:
            aside = self._archive.undo()
        except StoreError as error:
            return False, str(error)
        return True, f'set aside as {aside}'

    def _reset(self, _: Any) -> tuple[bool, str]:
        self._begin()
        return True, f'started again from {self._start.source or "the nominal values"}'

    def _set_enabled(self, request: Any) -> tuple[bool, str]:
        self._enabled = request.data
        return True, 'estimating' if request.data else 'messages are ignored'

    def _change(self, scenario: Scenario) -> None:
        self.scenario = scenario
        if self._calibrator:
            self._calibrator.use(scenario.estimator)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(Estimator, args)
