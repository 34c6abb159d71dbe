# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Publishing in the rhythm of the stamps: at their own speed, faster, or as fast as it is taken.

`Feed` is what the simulators and the player have in common. They make an iterator of what is to
be published, in the order of the stamps; the feed publishes what is due.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.node import Node

from starcal_ros.nodes import runtime
from starcal_ros.nodes.flow import FlowPublisher, drain

Item = tuple[int, FlowPublisher, Any]       # stamp [ns], where, message or CDR bytes

_PERIOD_S = 0.005
_TURN_S = 0.1                   # longest turn: signals, services and parameters get theirs
_ALWAYS_DUE = 2**63 - 1


class SimulatedClock:
    """A clock that shows a stamp when it begins and runs at a factor from then on.

    Parameters
    ----------
    start_ns : int
        Stamp that it shows when it begins.
    factor : float
        Simulated seconds a second; 0 shows a time at which everything is due.
    monotonic_ns : callable
        The time that really passes.
    """

    def __init__(self, start_ns: int, factor: float,
                 monotonic_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._start_ns, self._factor, self._monotonic_ns = start_ns, factor, monotonic_ns
        self._began_ns: int | None = None

    def begin(self) -> None:
        """Start to run; until then nothing is due."""
        self._began_ns = self._monotonic_ns()

    def now_ns(self) -> int:
        """Return the stamp up to which everything is due."""
        if self._began_ns is None:
            return self._start_ns - 1
        if self._factor == 0.0:
            return _ALWAYS_DUE
        return self._start_ns + round((self._monotonic_ns() - self._began_ns) * self._factor)


class Feed:
    """Publish items when their stamps are due, from a timer of the node.

    A subscriber that is behind delays the feed; what is late is then published at once.

    Attributes
    ----------
    published : int
        Number of items published.
    finished : bool
        True when all items are published and acknowledged.
    """

    def __init__(self, node: Node, clock: SimulatedClock, items: Iterator[Item]) -> None:
        self._clock, self._items = clock, items
        self._next = next(items, None)
        self._used: set[FlowPublisher] = set()
        self._timer = node.create_timer(_PERIOD_S, self._on_timer)
        self.published = 0
        self.finished = False

    def _on_timer(self) -> None:
        due_ns, turn_ends = self._clock.now_ns(), time.monotonic() + _TURN_S
        while (self._next is not None and self._next[0] <= due_ns
               and time.monotonic() < turn_ends and not runtime.stop_requested()):
            _, publisher, message = self._next
            if not publisher.publish(message):
                return
            self._used.add(publisher)
            self.published += 1
            self._next = next(self._items, None)
        if self._next is None and all(p.acknowledged for p in self._used):
            self.finished = True
            self._timer.cancel()

    def close(self) -> None:
        """Let the subscribers have what was published."""
        drain(self._used)
