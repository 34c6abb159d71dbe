# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Publishing without loss, at any speed.

A stream (gyro samples, frames) is offered and requested reliable and KEEP_ALL: the middleware
itself then refuses what it cannot keep. A subscriber that falls behind fills its queue (Fast DDS:
5000 messages), then that of the publisher, then `publish` fails. `FlowPublisher` repeats it
until it succeeds, so the slowest subscriber sets the pace and nothing is lost. A subscriber that
died without a word is forgotten when its lease ends (Fast DDS: 20 s).

A latched topic (results, truth) is transient local and keeps its last message: of several, who
comes late would get the oldest first, as `ros2 topic echo --once` showed. `FlowPublisher` waits
where it would overwrite one that a subscriber has not acknowledged, for one that is overwritten
is lost. That takes 5 ms by Fast DDS's default, 1 ms by `config/fastdds.xml`, or where the
acknowledgement is missed until it is asked for: after 3 s, or after 20 ms.

The other side is `matched_subscription`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
import math
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.timer import Timer

from starcal_ros.nodes.base import ending, run_loop
from starcal_ros.nodes.base.qos import LATCHED, POLICIES, STREAM

PATIENCE_S = 10.0               # of a node that serves sensors, with a subscriber that hangs
_POLL = Duration(seconds=0.05)  # a signal is seen between two of these
_WORTH_TELLING_S = 5.0
_GRACE_S = 3.0                  # after a stop, with a subscriber that takes nothing
_RETRY_S = 1.0                  # between tries for a subscriber that takes nothing


class FlowPublisher:
    """A publisher that waits for its subscribers where it would lose a message.

    Parameters
    ----------
    node : Node
    message_type : type
    topic : str
    latched : bool
        Keep the last message for those who come late, instead of streaming.
    patience_s : float
        Longest wait for a subscriber that takes nothing. After that messages are lost to it,
        which is said, until it takes some again: a node that serves real sensors can not stop
        for a display that hangs.

    Attributes
    ----------
    gave_up : bool
        Whether the process was asked to end and a subscriber took nothing more.
    """

    def __init__(self, node: Node, message_type: type, topic: str, *,
                 latched: bool = False, patience_s: float = math.inf) -> None:
        self._node = node
        self._publisher: Publisher[Any] = node.create_publisher(
            message_type, topic, LATCHED if latched else STREAM,
            event_callbacks=PublisherEventCallbacks(
                incompatible_qos=self._on_incompatible, use_default_callbacks=False))
        self.latched = latched
        self._log = node.get_logger()
        self._waiting_since: float | None = None
        self._patience_s = patience_s
        self._next_try = -math.inf      # when patience is at its end
        self._lost = 0
        self._told = self.gave_up = False

    @property
    def topic(self) -> str:
        """Resolved name of the topic."""
        return self._publisher.topic_name

    @property
    def subscribers(self) -> int:
        """Number of subscribers that are matched now."""
        return self._publisher.get_subscription_count()

    def lacks(self, nodes: Iterable[str]) -> list[str]:
        """Return which nodes, by names from the namespace of the own one, do not subscribe."""
        namespace = self._node.get_namespace().rstrip('/')
        there = {f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                 for info in self._node.get_subscriptions_info_by_topic(self.topic)}
        return [name for name in nodes
                if (name if name.startswith('/') else f'{namespace}/{name}') not in there]

    @property
    def acknowledged(self) -> bool:
        """True when every reliable subscriber holds all that was published."""
        return self._publisher.wait_for_all_acked(Duration())

    def destroy(self) -> None:
        """End the publisher; what is not acknowledged by now may be lost."""
        self._node.destroy_publisher(self._publisher)

    def publish(self, message: Any) -> bool:
        """Publish a message, or its CDR bytes; wait as long as a subscriber is behind.

        Returns
        -------
        published : bool
            False when the process was asked to end and a subscriber has taken nothing for some
            time, or patience is at its end.
        """
        if run_loop.stop_requested():       # before the loop can say so
            ending.announce(self._node)
        while self.gave_up or time.monotonic() < self._next_try or not self._try(message):
            if self.gave_up or min(self._waited_s, run_loop.seconds_since_stop()) > _GRACE_S:
                self._give_up()
                return False
            if self._waited_s > self._patience_s:
                self._lose()
                if not self.latched:
                    return False
                self._publisher.publish(message)        # the others get it all the same
                return True
            self._tell_waiting()
        self._tell_going_on()
        return True

    def _give_up(self) -> None:
        if not self.gave_up:            # what follows would wait in vain as well
            self.gave_up = True
            self.tell_undelivered()

    def tell_undelivered(self) -> None:
        """Say that the node ends though not all has arrived."""
        self._log.error(f'{self.topic}: a subscriber has not taken all, the rest is lost to it')

    def _try(self, message: Any) -> bool:
        if not self._has_room():
            return False
        try:
            self._publisher.publish(message)
        except RuntimeError:                # full, after 100 ms of waiting
            if self.subscribers:
                time.sleep(1e-3)            # in case the middleware did not wait
                return False
            self._publisher.publish(message)            # nobody to wait for: a real error
        return True

    def _has_room(self) -> bool:
        return not self.latched or bool(self._publisher.wait_for_all_acked(_POLL))

    @property
    def _waited_s(self) -> float:
        return time.monotonic() - self._waiting_since if self._waiting_since else 0.0

    def _lose(self) -> None:
        if not self._lost:
            self._log.error(f'{self.topic}: a subscriber has taken nothing for '
                            f'{self._waited_s:.0f} s, messages are lost to it')
        self._lost += 1
        if time.monotonic() >= self._next_try:
            self._next_try = time.monotonic() + _RETRY_S

    def _tell_waiting(self) -> None:
        self._waiting_since = self._waiting_since or time.monotonic()
        if not self._told and self._waited_s > _WORTH_TELLING_S:
            self._told = True
            self._log.warning(f'{self.topic}: a subscriber is behind, waiting for it')

    def _on_incompatible(self, event: Any) -> None:
        self._log.warning(f'{self.topic}: a subscriber asks for more than is offered '
                          f'({POLICIES.get(event.last_policy_kind, "an unknown policy")}) '
                          'and gets nothing')

    def _tell_going_on(self) -> None:
        if self._told:
            self._log.info(f'{self.topic}: going on after {self._waited_s:.1f} s'
                           + (f', {self._lost} messages lost' if self._lost else ''))
        self._waiting_since, self._told, self._lost = None, False, 0


def drain(publishers: Iterable[FlowPublisher], patience_s: float) -> None:
    """Wait at most `patience_s` until all that was published is acknowledged; say what is not."""
    deadline = time.monotonic() + patience_s
    for publisher in publishers:
        while not publisher.acknowledged and not publisher.gave_up:
            if time.monotonic() > deadline:
                publisher.tell_undelivered()
                break
            time.sleep(0.01)


def when_subscribed(node: Node, publishers: Iterable[FlowPublisher], count: int,
                    nodes: Iterable[str], callback: Callable[[], None], remark: str = ''
                    ) -> Timer:
    """Call back, once and from the loop, when each publisher has its subscribers; see `unheard`.

    Until then the timer that is returned looks for them. After five seconds it says what is
    missing, with a remark.
    """
    publishers, nodes = list(publishers), list(nodes)
    return when_there(node, lambda: unheard(publishers, count, nodes), callback, remark)


def unheard(publishers: Iterable[FlowPublisher], count: int, nodes: Iterable[str]) -> list[str]:
    """Return which publishers have not so many subscribers, or not those nodes, in words.

    Where it matters who listens the number is not enough: a recorder of rosbag2, or
    `ros2 topic echo`, is one, too.
    """
    missing = []
    for publisher in publishers:
        if publisher.subscribers < count:
            missing.append(f'{publisher.topic} has {publisher.subscribers} of {count} subscribers')
        if lacking := publisher.lacks(nodes):
            missing.append(f'{publisher.topic} has no subscriber {", ".join(lacking)}')
    return missing


def when_there(node: Node, missing: Callable[[], list[str]], callback: Callable[[], None],
               remark: str = '') -> Timer:
    """Call back, once and from the loop, when nothing is missing; see `when_subscribed`.

    Parameters
    ----------
    node : Node
    missing : callable
        Returns what is missing, in words.
    callback : callable
    remark : str
        Said after what is missing.
    """
    began, told = time.monotonic(), False

    def poll() -> None:
        nonlocal told
        wanting = missing()
        if not wanting:
            run_loop.end_timer(node, timer)
            callback()
        elif not told and time.monotonic() - began > _WORTH_TELLING_S:
            told = True
            node.get_logger().info(f'waiting: {", ".join(wanting)}{remark}')

    timer = run_loop.steady_timer(node, 0.02, poll)
    return timer
