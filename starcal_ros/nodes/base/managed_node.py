# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Managed nodes: configured, activated, deactivated and cleaned up from outside or by themselves.

::

    unconfigured ── configure ──► inactive ── activate ──► active
                 ◄── cleanup ───           ◄── deactivate ──

A subclass says what each of the four does. It makes its publishers with `offer` and, while it is
active, its subscriptions with `listen`; this class uses up what has arrived and ends both. With
the parameter ``autostart``, the default, a node is active as soon as it has been created, so that
`ros2 run` alone is enough; without it, it waits for `ros2 lifecycle set` or a lifecycle manager.

An inactive node subscribes to nothing, publishes nothing and holds up nobody. What it has worked
out stays, and what it missed shows in the stamps of what comes next.

No error of a callback or a service ends a node but those that its user can mend (USER_ERRORS): it
is said and counted (`faults`), and the node goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
import time
from typing import Any

from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.service import Service
from rclpy.timer import Timer

from starcal_ros.messages.topics import Topic
from starcal_ros.nodes.base import ending, parameters, run_loop
from starcal_ros.nodes.base.faults import Faults
from starcal_ros.nodes.base.flow_publisher import PATIENCE_S, FlowPublisher, drain, when_subscribed
from starcal_ros.nodes.base.matched_subscription import BATCH, MatchedSubscription
from starcal_ros.nodes.base.qos import message_type
from starcal_ros.nodes.base.run_loop import USER_ERRORS

_DRAIN_S = 10.0         # for the last messages; acknowledgements may take 3 s
_SILENCE_S = 10.0       # of nodes that are ending, after which they are waited for no more
_LOOK_S = 0.05          # between looks for them


class ManagedNode(parameters.AnsweringNode, LifecycleNode):
    """A managed node with parameters of the scenario.

    Parameters
    ----------
    name : str
        Name of the node.
    groups : str
        Groups of parameters to declare, as `parameters.declare` takes them.
    options : dict
        What rclpy's Node takes: ``namespace``, ``parameter_overrides``, ``context`` ...

    Attributes
    ----------
    scenario : Scenario
        Its parameters.
    inputs : list of MatchedSubscription
        What it listens to while it is active; the run loop empties them.
    outputs : list of FlowPublisher
        What it publishes while it is configured.
    faults : Faults
        What was wrong with messages, or went wrong.
    """

    def __init__(self, name: str, *groups: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.scenario = parameters.declare(self, 'autostart', *groups)
        self.inputs: list[MatchedSubscription] = []
        self.outputs: list[FlowPublisher] = []
        self.faults = Faults(self.get_logger())
        self._running: list[Timer] = []         # while active
        self._error: Exception | None = None
        self._raising = False           # whether whoever asks for a transition hears of an error
        self._next_look_s = 0.0
        self._received, self._heard_s = 0, 0.0

    def start(self) -> None:
        """Become active where ``autostart`` says so, or raise what keeps it from that."""
        if self.scenario.autostart:
            self._do(self.trigger_configure)
            self._do(self.trigger_activate)

    # What a subclass does

    def configure(self) -> None:
        """Make ready all but the subscriptions."""

    def activate(self) -> None:
        """Subscribe."""

    def deactivate(self) -> None:
        """Finish what has arrived: all of it has been handed over, and no timer runs any more."""

    def cleanup(self) -> None:
        """Give back what `configure` took, but the publishers."""

    def recover(self) -> None:
        """Make good what an error in a callback has left undone."""

    # For a subclass

    def offer(self, topic: Topic) -> FlowPublisher:
        """Return a publisher that is ended by `cleanup`, when all is delivered."""
        self.outputs.append(FlowPublisher(
            self, message_type(topic.type_name), topic.name, latched=topic.latched,
            patience_s=PATIENCE_S))
        return self.outputs[-1]

    def listen(self, topic: Topic, callback: Callable[[list[bytes]], None], at_once: int = BATCH,
               gather_s: float = 0.0, hurried: Callable[[], bool] = lambda: False) -> None:
        """Hand over the messages of a topic in CDR, until `deactivate`.

        How many at once, and how long they may wait: see `MatchedSubscription`.
        """
        self.inputs.append(MatchedSubscription(
            self, message_type(topic.type_name), topic.name,
            self._surviving(topic.name, callback), latched=topic.latched, raw=True,
            at_once=at_once, gather_s=gather_s, hurried=hurried))

    def repeat(self, period_s: float, callback: Callable[[], None],
               first_s: float | None = None) -> None:
        """Call back again and again, first after a period or `first_s`, until `deactivate`."""
        call = self._surviving(callback.__name__, callback)

        def begin() -> None:
            run_loop.end_timer(self, timer)
            self._running.remove(timer)
            self.repeat(period_s, callback)
            call()

        timer = run_loop.steady_timer(
            self, *((period_s, call) if first_s is None else (first_s, begin)))
        self._running.append(timer)

    def serve(self, service_type: type, name: str, answer: Callable[[Any], tuple[bool, str]]
              ) -> Service[Any, Any]:
        """Return a service that answers a request with success and a sentence."""
        def call(request: Any, response: Any) -> Any:
            try:
                response.success, response.message = answer(request)
            except Exception as error:
                self.faults.defect(name, error)
                response.success = False
                response.message = f'error in the node: {type(error).__name__}: {error}'
            return response
        return self.create_service(service_type, name, call)

    def _surviving(self, where: str, callback: Callable[..., None]) -> Callable[..., None]:
        def call(*args: Any) -> None:
            try:
                callback(*args)
            except (*USER_ERRORS, ExternalShutdownException):
                raise
            except Exception as error:
                self.faults.defect(where, error)
                self.recover()
        return call

    def when_heard(self, count: int, nodes: Iterable[str], callback: Callable[[], None]) -> None:
        """Call back when each of the outputs has its subscribers, not after `deactivate`."""
        def begin() -> None:
            self._running.remove(timer)         # has ended itself
            callback()

        timer = when_subscribed(self, self.outputs, count, nodes, begin)
        self._running.append(timer)

    # For the runtime

    @property
    def state(self) -> str:
        """Label of the state: unconfigured, inactive, active or finalized."""
        label: str = self._state_machine.current_state[1]       # rclpy has no public way
        return label

    @property
    def finished(self) -> bool:
        """True when the node has been shut down."""
        return self.state == 'finalized'

    def destroy_node(self) -> None:
        """Destroy the node, and its state machine: with that alive it stays in the graph.

        Of a node that was shut down it lives on: who asked for that may not have its answer yet.
        """
        super().destroy_node()
        if self.state != 'finalized':
            self._state_machine.destroy_when_not_in_use()       # which rclpy leaves to chance

    @property
    def drained(self) -> bool:
        """True when no other node that is ending speaks to this one any more."""
        now_s = time.monotonic()
        if not any(subscription.publishers for subscription in self.inputs):
            return True
        received = sum(subscription.received for subscription in self.inputs)
        if received != self._received:
            self._received, self._heard_s = received, now_s
        stopped_s = run_loop.seconds_since_stop()
        if stopped_s < ending.SETTLE_S or now_s < self._next_look_s:
            return False
        self._next_look_s = now_s + _LOOK_S
        speakers = ending.speakers(self, [subscription.topic for subscription in self.inputs])
        if speakers and min(stopped_s, now_s - self._heard_s) > _SILENCE_S:
            self.get_logger().error(f'{", ".join(speakers)}: silent for {_SILENCE_S:.0f} s and '
                                    'not ended: what is still to come is lost')
            return True
        return not speakers

    def close(self) -> None:
        """Shut the node down, from whatever state."""
        if self.finished:
            self._raise()               # what has ended it from inside
        else:
            self._do(self.trigger_shutdown)

    # For rclpy

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Answer to `configure`."""
        return self._try(self.configure)

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Answer to `activate`."""
        return self._try(self.activate)

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Answer to `deactivate`."""
        return self._try(self._deactivate)

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Answer to `cleanup`."""
        return self._try(self._cleanup)

    def on_shutdown(self, before: LifecycleState) -> TransitionCallbackReturn:
        """Answer to `shutdown`: undo what the state before stands on."""
        steps = {'active': [self._deactivate, self._cleanup], 'inactive': [self._cleanup]}
        return self._try(*steps.get(before.label, []))

    def on_error(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Answer to a defect: the node ends, and `close` raises it."""
        return TransitionCallbackReturn.FAILURE

    def _deactivate(self) -> None:
        for timer in self._running:
            run_loop.end_timer(self, timer)
        self._running.clear()
        for subscription in self.inputs:
            subscription.take_all()
        self.deactivate()
        for subscription in self.inputs:
            subscription.destroy()
        self.inputs.clear()
        self.faults.sum_up()

    def _cleanup(self) -> None:
        self.cleanup()
        drain(self.outputs, _DRAIN_S)
        for publisher in self.outputs:
            publisher.destroy()
        self.outputs.clear()

    def _try(self, *steps: Callable[[], None]) -> TransitionCallbackReturn:
        # rclpy itself would swallow an exception without a word.
        for step in steps:
            try:
                step()
            except USER_ERRORS as error:
                if self._raising:
                    self._error = error
                else:
                    self.get_logger().error(f'{step.__name__.lstrip("_")}: {error}')
                return TransitionCallbackReturn.FAILURE
            except Exception as error:
                self._error = error
                return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _do(self, trigger: Callable[[], Any]) -> None:
        self._raising = True
        trigger()
        self._raising = False
        self._raise()

    def _raise(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error
