# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `star_identifier`: spots in, the same spots with their Hipparcos numbers out.

A frame waits for the gyro readings up to its stamp, four seconds at most; then it goes without.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from itertools import islice
import time
from typing import Any, NamedTuple

from starcal_ros.config.parameter import ConfigError
from starcal_ros.core.arrays import Ints
from starcal_ros.identification.frame_identifier import FrameIdentifier
from starcal_ros.messages import cdr, cdr_imu, cdr_pointcloud, topics
from starcal_ros.nodes.base import run_loop
from starcal_ros.nodes.base.decoding import decoded
from starcal_ros.nodes.base.managed_node import ManagedNode
from starcal_ros.nodes.base.tally import Tally

_PATIENCE_S = 4.0       # of a frame, with the gyro: Fast DDS sends again what it lost after 3 s
_LOOK_S = 0.1


class _Waiting(NamedTuple):
    """A frame that has no numbers yet, and when it came."""

    cloud: bytes
    since_s: float


class StarIdentifier(ManagedNode):
    """Feed a `FrameIdentifier` from two topics; publish frames with catalogue numbers."""

    def __init__(self, **options: Any) -> None:
        super().__init__('star_identifier', 'camera', 'mounting', 'gyro', 'star_tracker',
                         'observer', 'estimator', 'intrinsics', 'star_identifier', **options)
        self.start()

    def configure(self) -> None:
        """Prepare the identification, which takes some seconds, and its publisher."""
        try:
            self._identifier = FrameIdentifier(self.scenario)
        except (ImportError, ValueError) as error:
            raise ConfigError(str(error)) from None
        self._waiting: deque[_Waiting] = deque()
        self._stars = self.offer(topics.CENTROIDS)

    def activate(self) -> None:
        """Listen, as soon as the numbered frames have the listeners they must have."""
        self._tally = Tally(self, 'identification', self.faults.counts)
        self.repeat(_LOOK_S, self._advance)
        own = self.scenario.star_identifier
        self.when_heard(own.wait_for_subscribers, own.wait_for_nodes, self._listen)

    def _listen(self) -> None:
        self.listen(topics.IMU, self._on_gyro)
        self.listen(topics.SPOTS, self._on_spots)

    def deactivate(self) -> None:
        """Let frames that wait go without the readings they wait for; say what was done."""
        self._publish(self._identifier.process(wait=False))
        self._tally.end()

    def _on_gyro(self, batch: list[bytes]) -> None:
        for part in decoded(batch, cdr_imu.decode_imu, self._drop):
            self._identifier.add_gyro(part)
        self._advance()

    def _on_spots(self, batch: list[bytes]) -> None:
        self.inputs[0].take_all()       # readings that have come, though their publisher is gone
        for message in batch:
            for frames in decoded([message], cdr_pointcloud.decode_centroids, self._drop):
                self._identifier.add_frames(frames)
                self._tally.newest_ns = int(frames.stamp_ns[-1])
                self._waiting.append(_Waiting(message, time.monotonic()))
        self._advance()

    def _drop(self, why: str) -> None:
        self.faults.add('damaged message', why)

    def _advance(self) -> None:
        """Publish what need not wait for the gyro, or has waited long enough."""
        self._publish(self._identifier.process(wait=True))
        while self._waiting and (time.monotonic() - self._waiting[0].since_s > _PATIENCE_S
                                 or not self.inputs[0].publishers):
            self._publish(islice(self._identifier.process(wait=False), 1))

    def _publish(self, numbers: Iterable[Ints]) -> None:
        for number in numbers:
            message = self._waiting.popleft().cloud
            try:
                message = cdr_pointcloud.with_catalog_ids(message, number)
            except cdr.RecordError as error:
                self.faults.add('unsuitable cloud', f'message dropped: {error}')
                continue
            self._stars.publish(message)
        for text in self._identifier.take_notices():
            self.faults.alike(text)
        self._tally.done.update(self._identifier.take_counts())


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(StarIdentifier, args)
