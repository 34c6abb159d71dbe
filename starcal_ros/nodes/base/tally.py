# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a node has done and what was wrong, in diagnostics."""

from __future__ import annotations

from collections import Counter

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from starcal_ros.messages import topics
from starcal_ros.nodes.base import run_loop
from starcal_ros.nodes.base.stamps import status_stamp

_PERIOD_S = 1.0


class Tally:
    """Counts of a node, published on `diagnostics` once a second.

    Parameters
    ----------
    node : Node
    name : str
        Of the status; the namespace stands before it.
    faults : Counter
        What was wrong with messages, by its kind.

    Attributes
    ----------
    done : Counter
        What has been done, by what it is.
    newest_ns : int
        Stamp of the last message that was of use.
    """

    def __init__(self, node: Node, name: str, faults: Counter[str]) -> None:
        self._node = node
        self._prefix = f'{node.get_namespace().strip("/")}/'.lstrip('/')
        self._name, self._faults = name, faults
        self.done: Counter[str] = Counter()
        self.newest_ns = 0
        self._said: Counter[str] = Counter()
        # Depth 1: the newest counts are all that anybody wants, and nobody is waited for.
        self._publisher = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS.name, 1)
        self._timer = run_loop.steady_timer(node, _PERIOD_S, self._publish)

    def end(self) -> None:
        """Say what was done, and publish no more."""
        run_loop.end_timer(self._node, self._timer)
        self._publish()
        counts = self.done + self._faults
        self._node.get_logger().info(
            ', '.join(f'{number} {what}' for what, number in counts.items()) or 'nothing came')
        self._node.destroy_publisher(self._publisher)

    def _publish(self) -> None:
        fresh, self._said = self._faults - self._said, self._faults.copy()
        message = DiagnosticArray(status=[DiagnosticStatus(
            name=f'{self._prefix}starcal: {self._name}',
            level=DiagnosticStatus.ERROR if fresh else DiagnosticStatus.OK,
            message=', '.join(f'{n} {kind}' for kind, n in fresh.items()) or 'working',
            hardware_id=f'{self._prefix}star_tracker',
            values=[KeyValue(key=what, value=str(number))
                    for what, number in [*self.done.items(), *self._faults.items()]])])
        message.header.stamp = status_stamp(self._node, self.newest_ns)
        self._publisher.publish(message)
