# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Publishing and subscribing without loss, at any speed.

A stream (gyro samples, frames) is offered and requested reliable and KEEP_ALL: the middleware
itself then refuses what it cannot keep. A subscriber that falls behind fills its queue (Fast DDS:
5000 messages), then that of the publisher, then `publish` fails. `FlowPublisher` repeats it
until it succeeds, so the slowest subscriber sets the pace and nothing is lost. A subscriber that
died without a word is forgotten when its lease ends (Fast DDS: 20 s).

A latched topic (results, truth) is transient local and keeps its last messages. `FlowPublisher`
waits where it would overwrite one that a subscriber has not acknowledged. With a depth of 1 that
would be before each message, and an acknowledgement takes 5 ms, or 3 s where one is missed and
nothing more is published. So the depth is 100; who asks for the last one gets the last one.

`MatchedSubscription` requests the same, or the lower policy that a publisher offers. It takes
all that waits at once, ten times as fast as a callback a message.

What the middleware can not match is said in words, by both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
import math
import sys
import time
from typing import Any
from weakref import WeakKeyDictionary

from rclpy.duration import Duration
from rclpy.event_handler import (PublisherEventCallbacks, SubscriptionEventCallbacks,
                                 UnsupportedEventTypeError)
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from starcal_ros.nodes.base import run_loop

STREAM = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_ALL,
                    durability=DurabilityPolicy.VOLATILE)
LATCHED = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_LAST,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=100)

_POLICY = {QoSPolicyKind.DURABILITY: 'durability: the last messages for who comes late',
           QoSPolicyKind.DEADLINE: 'deadline: a message at least so often',
           QoSPolicyKind.LIVELINESS: 'liveliness: a sign of life at least so often',
           QoSPolicyKind.RELIABILITY: 'reliability: lost messages sent again'}

PATIENCE_S = 10.0               # of a node that serves sensors, with a subscriber that hangs
BATCH = 500                     # most messages of one drain: other callbacks get their turn
_MOST_WAITING = 5000            # messages that Fast DDS keeps for a subscriber
_POLL = Duration(seconds=0.05)  # a signal is seen between two of these
_WORTH_TELLING_S = 5.0
_GRACE_S = 3.0                  # after a stop, to hand over what has been worked out
_LOOK_S = 0.25                  # between looks for messages that nobody announced
_LOOKED_AT: WeakKeyDictionary[Node, list[MatchedSubscription]] = WeakKeyDictionary()
_RETRY_S = 1.0                  # between tries for a subscriber that takes nothing


class FlowPublisher:
    """A publisher that waits for its subscribers where it would lose a message.

    Parameters
    ----------
    node : Node
    message_type : type
    topic : str
    latched : bool
        Keep the last messages for those who come late, instead of streaming.
    patience_s : float
        Longest wait for a subscriber that takes nothing. After that messages are lost to it,
        which is said, until it takes some again: a node that serves real sensors can not stop
        for a display that hangs.
    """

    def __init__(self, node: Node, message_type: type, topic: str, *,
                 latched: bool = False, patience_s: float = math.inf) -> None:
        self._node = node
        self._publisher: Publisher[Any] = node.create_publisher(
            message_type, topic, LATCHED if latched else STREAM,
            event_callbacks=PublisherEventCallbacks(
                incompatible_qos=self._on_incompatible, use_default_callbacks=False))
        self.latched = latched
        self._depth = LATCHED.depth if latched else sys.maxsize
        self._unacknowledged = 0        # messages since all were acknowledged
        self._log = node.get_logger()
        self._waiting_since: float | None = None
        self._patience_s = patience_s
        self._next_try = -math.inf      # when patience is at its end
        self._lost = 0
        self._told = self._gave_up = False

    @property
    def topic(self) -> str:
        """Resolved name of the topic."""
        return self._publisher.topic_name

    @property
    def subscribers(self) -> int:
        """Number of subscribers that are matched now."""
        return self._publisher.get_subscription_count()

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
            False when the process was asked to end some time ago, or patience is at its end.
        """
        while self._gave_up or time.monotonic() < self._next_try or not self._try(message):
            if run_loop.seconds_since_stop() > _GRACE_S:
                self._gave_up = True        # what follows would wait in vain as well
                return False
            if self._waited_s > self._patience_s:
                self._lose()
                return False
            self._tell_waiting()
        self._tell_going_on()
        return True

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
        self._unacknowledged += 1
        return True

    def _has_room(self) -> bool:
        # From half the depth on, each message first waits a little for all acknowledgements. It
        # is published without them while there is room: that asks the subscribers once more.
        if self._unacknowledged >= self._depth // 2 and self._publisher.wait_for_all_acked(_POLL):
            self._unacknowledged = 0
        return self._unacknowledged < self._depth

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
                          f'({_POLICY.get(event.last_policy_kind, "an unknown policy")}) and gets '
                          'nothing')

    def _tell_going_on(self) -> None:
        if self._told:
            self._log.info(f'{self.topic}: going on after {self._waited_s:.1f} s'
                           + (f', {self._lost} messages lost' if self._lost else ''))
        self._waiting_since, self._told, self._lost = None, False, 0


def drain(publishers: Iterable[FlowPublisher], patience_s: float = 1.0) -> bool:
    """Wait until all that was published is acknowledged, but no longer than this."""
    deadline = time.monotonic() + patience_s
    for publisher in publishers:
        while not publisher.acknowledged:
            if time.monotonic() > deadline:
                return False
            time.sleep(0.01)
    return True


def when_subscribed(node: Node, publishers: Iterable[FlowPublisher], count: int,
                    callback: Callable[[], None]) -> Timer:
    """Call back, once and from the loop, when each publisher has that many subscribers.

    Until then the timer that is returned looks for them.
    """
    publishers, began, told = list(publishers), time.monotonic(), False

    def poll() -> None:
        nonlocal told
        missing = [publisher for publisher in publishers if publisher.subscribers < count]
        if not missing:
            run_loop.end_timer(node, timer)
            callback()
        elif not told and time.monotonic() - began > _WORTH_TELLING_S:
            told = True
            node.get_logger().info('waiting for subscribers: ' + ', '.join(
                f'{publisher.topic} has {publisher.subscribers} of {count}'
                for publisher in missing))

    timer = run_loop.steady_timer(node, 0.02, poll)
    return timer


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

    Attributes
    ----------
    received : int
        Number of messages handed over.
    lost : int
        Number of messages that the middleware says it has lost.
    """

    def __init__(self, node: Node, message_type: type, topic: str,
                 callback: Callable[[list[Any]], None], *,
                 latched: bool = False, raw: bool = False, at_once: int = BATCH) -> None:
        self._node, self._type, self._topic, self._raw = node, message_type, topic, raw
        self._callback, self._at_once = callback, at_once
        self._reliability = ReliabilityPolicy.RELIABLE
        self._durability = LATCHED.durability if latched else STREAM.durability
        self.received, self.lost = 0, 0
        self._subscription = self._create()
        self._outdated = False
        _looked_at(node).append(self)

    @property
    def topic(self) -> str:
        """Resolved name of the topic."""
        return self._subscription.topic_name

    @property
    def publishers(self) -> int:
        """Number of publishers that are matched now."""
        return self._subscription.get_publisher_count()

    def take_all(self) -> None:
        """Hand over all that waits, now; not what a publisher adds in the meantime."""
        for _ in range(_MOST_WAITING // self._at_once):
            self._hand_over(_take_waiting(self._subscription, self._at_once))

    def destroy(self) -> None:
        """End the subscription."""
        self._callback = lambda messages: None      # for what is under way in the executor
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
        """Hand over what waits, and return how much; ask the publishers for less if need be."""
        if self._outdated:
            self._recreate()
        # What arrives while messages are taken does not always wake the executor once more.
        self._hand_over(waiting := _take_waiting(self._subscription, self._at_once))
        return len(waiting)

    def _on_message(self, message: Any) -> None:
        self._hand_over([message, *_take_waiting(self._subscription, self._at_once - 1)])

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
                f'({_POLICY.get(event.last_policy_kind, "an unknown policy")}), so that nothing '
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
    """Return the subscriptions of a node that one timer looks at again and again."""
    if node not in _LOOKED_AT:
        subscriptions = _LOOKED_AT[node] = []
        run_loop.steady_timer(node, _LOOK_S, lambda: [
            subscription.look_again() for subscription in list(subscriptions)])
    return _LOOKED_AT[node]


def _take_waiting(subscription: Subscription[Any], limit: int) -> list[Any]:
    """Take what waits behind the message of a callback; the one use of this half-public API."""
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
