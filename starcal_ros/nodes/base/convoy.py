# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulators that advance together: none runs ahead of the slowest by more than a few seconds.

Each tells on `simulation/progress` up to which stamp it has published all, and publishes nothing
more than LEAD_S ahead of the least that it hears from the others. The last of them is never held
up, so the convoy always moves. One that is over tells a time that is never reached; one that has
left the graph, killed (Fast DDS: after 20 s) or not, is waited for no more.

Without it the queues alone hold up who is ahead: 5000 messages at the subscriber and 5000 at the
publisher are 100 s of a gyro, and 83 min of a star tracker.
"""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from std_msgs.msg import Header

from starcal_ros.messages import topics
from starcal_ros.nodes.base.matched_subscription import take_waiting
from starcal_ros.nodes.base.qos import LATCHED

LEAD_S = 10.0           # far more than is published in a turn of the loop, at any speed
_STEP_NS = 10**9        # between two reports
_AT_ONCE = 10           # reports
_OVER = Time(sec=2**31 - 1)
UNLIMITED_NS = 2**63 - 1
_LEAD_NS = round(LEAD_S * 1e9)


class Convoy:
    """What one simulator tells the others of its progress, and hears of theirs.

    It is an `Input` of the loop: who waits goes on as soon as it hears.

    Parameters
    ----------
    node : Node
        The simulator.
    start_ns : int
        Stamp at which its run begins.
    """

    def __init__(self, node: Node, start_ns: int) -> None:
        self._node, self._name = node, node.get_fully_qualified_name()
        self._heard_ns: dict[str, int] = {}     # by node
        self._publisher = node.create_publisher(Header, topics.PROGRESS.name, LATCHED)
        self._subscription = node.create_subscription(
            Header, topics.PROGRESS.name, self._hear, LATCHED)
        self._told_ns = start_ns - _STEP_NS
        self.tell(start_ns)

    @property
    def handle(self) -> Any:
        """That of rclpy, to wait with."""
        return self._subscription.handle

    @property
    def rests_s(self) -> float:
        """Nothing: each report counts."""
        return 0.0

    def look_again(self) -> int:
        """Hear what waits."""
        reports = take_waiting(self._subscription, _AT_ONCE)
        for report in reports:
            self._hear(report)
        return len(reports)

    @property
    def others(self) -> int:
        """Number of other simulators that have been heard and are there."""
        return len(self._heard_ns)

    @property
    def limit_ns(self) -> int:
        """Stamp up to which may be published now."""
        if len(self._heard_ns) > self._subscription.get_publisher_count() - 1:      # one is ours
            self._forget_who_has_left()
        return min(self._heard_ns.values(), default=UNLIMITED_NS - _LEAD_NS) + _LEAD_NS

    def tell(self, stamp_ns: int | None) -> None:
        """Tell that all before a stamp is published; None: that all of the run is, once."""
        if stamp_ns is None:
            if self._told_ns != UNLIMITED_NS:
                self._told_ns = UNLIMITED_NS
                self._publisher.publish(Header(stamp=_OVER, frame_id=self._name))
        elif stamp_ns >= self._told_ns + _STEP_NS:
            self._told_ns = stamp_ns
            sec, nanosec = divmod(stamp_ns, 10**9)
            self._publisher.publish(Header(stamp=Time(sec=sec, nanosec=nanosec),
                                           frame_id=self._name))

    def _hear(self, progress: Header) -> None:
        if progress.frame_id == self._name:
            return
        over = progress.stamp == _OVER
        self._heard_ns[progress.frame_id] = (
            UNLIMITED_NS - _LEAD_NS if over else
            progress.stamp.sec * 10**9 + progress.stamp.nanosec)

    def _forget_who_has_left(self) -> None:
        there = {f'{info.node_namespace.rstrip("/")}/{info.node_name}' for info in
                 self._node.get_publishers_info_by_topic(self._subscription.topic_name)}
        self._heard_ns = {name: stamp_ns for name, stamp_ns in self._heard_ns.items()
                          if name in there}
