# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Publishing in the rhythm of the stamps: at their own speed, faster, or as fast as it is taken.

`Feed` is what the simulators and the player have in common. They make an iterator of what is to
be published, in the order of the stamps; the feed publishes what is due.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
import math
import time
from typing import Any

from rclpy.node import Node
from rclpy.timer import Timer

from starcal_ros.core.units import NS
from starcal_ros.nodes.base import run_loop
from starcal_ros.nodes.base.flow_publisher import FlowPublisher, drain
from starcal_ros.nodes.base.matched_subscription import BATCH

Item = tuple[int, FlowPublisher, Any]       # stamp [ns], where, message or CDR bytes

DRAIN_S = 30.0                  # after a stop, for subscribers to take what was published
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
    real_ns : callable
        The time that really passes.
    limit_ns : callable
        Stamp at which it stands until there is a later one.
    """

    def __init__(self, start_ns: int, factor: float,
                 real_ns: Callable[[], int] = time.monotonic_ns,
                 limit_ns: Callable[[], int] = lambda: _ALWAYS_DUE) -> None:
        self._start_ns, self._factor, self._real_ns = start_ns, factor, real_ns
        self._limit_ns = limit_ns
        self._shown_ns = start_ns - 1               # when it last began to run or was stopped
        self._running_since_ns: int | None = None
        self._begun = self._stopped = False

    @property
    def begun(self) -> bool:
        """Whether it shows the start or later."""
        return self._begun

    def begin(self) -> None:
        """Show the start, and run; until then nothing is due."""
        self._shown_ns, self._begun = self._start_ns, True
        self._running_since_ns = None if self._stopped else self._real_ns()

    def stop(self) -> None:
        """Stand still."""
        self._shown_ns, self._stopped = self.now_ns(), True
        self._running_since_ns = None

    def go_on(self) -> None:
        """Run again, from what is shown."""
        self._stopped = False
        if self._begun and self._running_since_ns is None:
            self._running_since_ns = self._real_ns()

    def now_ns(self) -> int:
        """Return the stamp up to which everything is due."""
        if self._running_since_ns is None:
            return self._shown_ns
        limit_ns = self._limit_ns()
        if self._factor == 0.0:
            return limit_ns
        real_ns = self._real_ns()
        self._running_since_ns = self._running_since_ns or real_ns      # 0: no /clock yet
        now_ns = self._shown_ns + round((real_ns - self._running_since_ns) * self._factor)
        if now_ns > limit_ns:
            self._shown_ns, self._running_since_ns = limit_ns, real_ns
        return min(now_ns, limit_ns)

    def seconds_to(self, stamp_ns: int) -> float:
        """Return how long it takes to a stamp, infinite while the clock stands before it."""
        left_ns = stamp_ns - self.now_ns()
        if left_ns <= 0:
            return 0.0
        stands = self._running_since_ns is None or stamp_ns > self._limit_ns()
        return math.inf if stands or self._factor == 0.0 else left_ns * NS / self._factor


def passing_time(node: Node) -> Callable[[], int]:
    """Return the time by which a node runs [ns]: that of /clock with `use_sim_time`."""
    if node.get_parameter('use_sim_time').value:
        return lambda: int(node.get_clock().now().nanoseconds)
    return time.monotonic_ns


class Feed:
    """Publish items when their stamps are due: an `Input` of the loop, or else from a timer.

    A subscriber that is behind delays the feed; what is late is then published at once.

    Parameters
    ----------
    node : Node
    clock : SimulatedClock
        Tells what is due.
    items : iterator of Item
        In the order of their stamps.
    on_progress : callable
        Called with the stamp before which all is published, None when all is.

    Attributes
    ----------
    published : Counter of FlowPublisher
        Number of items published by each.
    paused : bool
        True while nothing is published by request.
    finished : bool
        True when all items are published and acknowledged.
    """

    def __init__(self, node: Node, clock: SimulatedClock, items: Iterator[Item],
                 on_progress: Callable[[int | None], None] = lambda stamp_ns: None) -> None:
        self._node, self._clock, self._items, self._on_progress = node, clock, items, on_progress
        self._next = next(items, None)
        self._last_ns = self._next[0] if self._next else 0
        self._take_turn = run_loop.guarded(self._publish_due)
        self._timer: Timer | None = run_loop.steady_timer(node, _PERIOD_S, self._publish_due)
        self.published: Counter[FlowPublisher] = Counter()
        self.paused = self.finished = False

    @property
    def now_ns(self) -> int:
        """The time of the clock, less what the subscribers delay the feed by."""
        return min(self._clock.now_ns(), self._next[0] if self._next else self._last_ns)

    @property
    def handle(self) -> None:
        """None: time alone wakes it."""

    @property
    def rests_s(self) -> float:
        """How long nothing is due."""
        if self._next is None or self.paused or run_loop.stop_requested():
            return math.inf
        return self._clock.seconds_to(self._next[0])

    def look_again(self) -> int:
        """Publish what is due, and return how much that was; who calls this needs no timer."""
        self._end_timer()
        before = self.published.total()
        self._take_turn()
        return self.published.total() - before

    def pause(self) -> None:
        """Publish nothing until `resume`."""
        self.paused = True
        self._clock.stop()

    def resume(self) -> None:
        """Go on where `pause` stopped."""
        self.paused = False
        self._clock.go_on()

    def _publish_due(self) -> None:
        due_ns, turn_ends = self._clock.now_ns(), time.monotonic() + _TURN_S
        for _ in range(BATCH):          # no more than a subscriber of this process takes at once
            if (self._next is None or self._next[0] > due_ns or self.paused
                    or time.monotonic() > turn_ends or run_loop.stop_requested()):
                break
            self._last_ns, publisher, message = self._next
            if not publisher.publish(message):
                return
            self.published[publisher] += 1
            self._next = next(self._items, None)
        self._on_progress(self._next[0] if self._next else None)
        if self._next is None and all(p.acknowledged for p in self.published):
            self.finished = True
            self._end_timer()

    def _end_timer(self) -> None:
        if self._timer:
            run_loop.end_timer(self._node, self._timer)
            self._timer = None

    @property
    def drained(self) -> bool:
        """True when the subscribers have what was published, or do not take it."""
        return (run_loop.seconds_since_stop() > DRAIN_S
                or all(each.acknowledged or each.gave_up for each in self.published))

    def close(self) -> None:
        """Let the subscribers have what was published."""
        drain(self.published, 0.0 if run_loop.stop_requested() else DRAIN_S)
