# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Subscribing without loss, to whatever a publisher offers.

`MatchedSubscription` requests what `flow_publisher` offers, or the lower policy that a publisher
offers. It takes all that waits at once, ten times as fast as a callback a message. What the
middleware can not match is said in words.
"""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import Any
from weakref import WeakKeyDictionary

from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from starcal_ros.nodes.base import run_loop
from starcal_ros.nodes.base.qos import LATCHED, POLICIES, STREAM

BATCH = 500                     # most messages of one drain: other callbacks get their turn
_MOST_WAITING = 5000            # messages that Fast DDS keeps for a subscriber
BACKLOG_S = 40.0                # after a stop, to use up what has come
_LOOK_S = 0.25                  # between looks for messages that nobody announced
_LOOKED_AT: WeakKeyDictionary[Node, list[MatchedSubscription]] = WeakKeyDictionary()
_LOOKS: WeakKeyDictionary[Node, Timer] = WeakKeyDictionary()


class MatchedSubscription:
    """A subscription that takes what each publisher offers, without loss where that can be.

    It begins reliable (and transient local where `latched`). When a publisher offers less, it
    requests less from then on, of all publishers of the topic.

    Parameters
    ----------
    node : Node
    message_type : type
    topic : str
    callback : callable
        Receives a list of messages, in the order of arrival, at least one and at most `at_once`.
    latched : bool
        Ask for the last message that was published before.
    raw : bool
        Receive CDR bytes in place of messages.
    at_once : int
        Fewer where a message is large or takes long.
    gather_s : float
        After messages were taken, the next may wait so long for more: each time takes its time,
        however many there are. Not where as many have come as are taken at once.
    hurried : callable
        Tells whether they may not.

    Attributes
    ----------
    received : int
        Number of messages handed over.
    lost : int
        Number of messages that the middleware says it has lost.
    """

    def __init__(self, node: Node, message_type: type, topic: str,
                 callback: Callable[[list[Any]], None], *,
                 latched: bool = False, raw: bool = False, at_once: int = BATCH,
                 gather_s: float = 0.0, hurried: Callable[[], bool] = lambda: False) -> None:
        self._node, self._type, self._topic, self._raw = node, message_type, topic, raw
        self._callback, self._at_once = callback, at_once
        self._gather_s, self._hurried, self._next_s = gather_s, hurried, 0.0
        self._reliability = ReliabilityPolicy.RELIABLE
        self._durability = LATCHED.durability if latched else STREAM.durability
        self.received, self.lost = 0, 0
        self._subscription = self._create()
        self._resolved = self._subscription.topic_name      # rclpy asks rcl each time
        self._outdated = self._destroyed = False
        _looked_at(node).append(self)

    @property
    def topic(self) -> str:
        """Resolved name of the topic."""
        return self._resolved

    @property
    def publishers(self) -> int:
        """Number of publishers that are matched now."""
        return self._subscription.get_publisher_count()

    @property
    def handle(self) -> Any:
        """That of rclpy, to wait with."""
        return self._subscription.handle

    @property
    def rests_s(self) -> float:
        """How long messages are left to gather from now on."""
        if not self._gather_s or self._hurried():
            return 0.0
        return max(self._next_s - time.monotonic(), 0.0)

    def take_all(self) -> None:
        """Hand over all that waits, now; not what a publisher adds in the meantime.

        Where the process was asked to end BACKLOG_S ago, what is left is dropped, and that said.
        """
        for _ in range(_MOST_WAITING // self._at_once):
            if run_loop.seconds_since_stop() > BACKLOG_S:
                break
            self._hand_over(self._take_waiting(self._at_once))
        else:
            return
        if left := len(self._take_waiting(_MOST_WAITING)):
            self._node.get_logger().error(
                f'{self.topic}: {left} messages that have come are not used, as the node was '
                f'asked to end {BACKLOG_S:.0f} s ago')

    def destroy(self) -> None:
        """End the subscription; there is nothing more to take then."""
        self._callback = lambda messages: None      # for what is under way in the executor
        self._destroyed = True
        _looked_at(self._node).remove(self)
        self._node.destroy_subscription(self._subscription)

    def _create(self) -> Subscription[Any]:
        qos = QoSProfile(reliability=self._reliability, durability=self._durability,
                         history=HistoryPolicy.KEEP_ALL)
        events = SubscriptionEventCallbacks(
            incompatible_qos=self._on_incompatible, message_lost=self._on_lost,
            use_default_callbacks=False)        # each costs time, message by message
        on_message = run_loop.guarded(self._on_message)
        try:
            return self._node.create_subscription(
                self._type, self._topic, on_message, qos, raw=self._raw, event_callbacks=events)
        except UnsupportedEventTypeError:       # by this middleware; the other rclpy skips itself
            events.message_lost = None
            return self._node.create_subscription(
                self._type, self._topic, on_message, qos, raw=self._raw, event_callbacks=events)

    def look_again(self) -> int:
        """Look, and return how much there was; who calls this again and again needs no timer."""
        if looks := _LOOKS.pop(self._node, None):
            run_loop.end_timer(self._node, looks)
        return self._look()

    def _look(self) -> int:
        """Hand over what waits, and return how much; ask the publishers for less if need be."""
        if self._outdated and not self._destroyed:
            self._recreate()
        if self.rests_s > 0.0:
            return 0
        # What arrives while messages are taken does not always wake the executor once more.
        waiting = self._take_waiting(self._at_once)
        self._take(waiting)
        return len(waiting)

    def _take(self, messages: list[Any]) -> None:
        if 0 < len(messages) < self._at_once:
            self._next_s = time.monotonic() + self._gather_s
        self._hand_over(messages)

    def _on_message(self, message: Any) -> None:
        self._take([message, *self._take_waiting(self._at_once - 1)])

    def _take_waiting(self, limit: int) -> list[Any]:
        return [] if self._destroyed else take_waiting(self._subscription, limit)

    def _hand_over(self, messages: list[Any]) -> None:
        if messages:
            self.received += len(messages)
            self._callback(messages)

    def _on_lost(self, event: Any) -> None:
        if not self.lost:
            self._node.get_logger().warning(
                f'{self.topic}: the middleware has lost messages, {event.total_count} at first')
        self.lost += event.total_count_change

    def _on_incompatible(self, event: Any) -> None:
        if event.last_policy_kind == QoSPolicyKind.RELIABILITY:
            self._reliability, offer = ReliabilityPolicy.BEST_EFFORT, 'best effort'
        elif event.last_policy_kind == QoSPolicyKind.DURABILITY:
            self._durability, offer = DurabilityPolicy.VOLATILE, 'volatile'
        else:
            self._node.get_logger().warning(
                f'{self.topic}: a publisher offers less than is asked for '
                f'({POLICIES.get(event.last_policy_kind, "an unknown policy")}), so that nothing '
                'is received from it')
            return
        self._node.get_logger().warning(
            f'{self.topic}: a publisher offers {offer} only, so that is requested now')
        self._outdated = True           # replaced later: this event belongs to what is replaced

    def _recreate(self) -> None:
        self.take_all()
        self._node.destroy_subscription(self._subscription)
        self._subscription, self._outdated = self._create(), False


def _looked_at(node: Node) -> list[MatchedSubscription]:
    """Return the subscriptions of a node, at which one timer looks where no loop does."""
    if node not in _LOOKED_AT:
        subscriptions = _LOOKED_AT[node] = []
        _LOOKS[node] = run_loop.steady_timer(node, _LOOK_S, lambda: [
            subscription._look() for subscription in list(subscriptions)])
    return _LOOKED_AT[node]


def take_waiting(subscription: Subscription[Any], limit: int) -> list[Any]:
    """Take what waits, without the executor; the one use of this half-public API."""
    messages: list[Any] = []
    handle = subscription.handle
    with handle:
        take = getattr(handle, 'take_message', None)
        while take and len(messages) < limit:
            taken = take(subscription.msg_type, subscription.raw)
            if taken is None:
                break
            messages.append(taken[0])
    return messages
