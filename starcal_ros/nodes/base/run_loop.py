# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Run nodes from their creation to a clean end: the body of every `main`.

SIGINT, SIGTERM and SIGHUP (a terminal that is closed) only set a flag. The loop below and
all that waits (`flow_publisher`) look at it, so a node is never interrupted halfway: it closes its
file, leaves the graph and exits with status 0. With rclpy's own handlers some exits, too early or
too late a Ctrl-C, end in a traceback. Under `nohup`, which ignores SIGHUP, it stays ignored.

A node may have

* ``finished``: true when it has nothing left to do; it is then destroyed, and when none is left
  the process ends;
* ``failed``: true when it could not do what it is there for, and has said so; the others go on,
  and the process ends with status 1;
* ``drained``: false while there is something to wait for though the process was asked to end, as
  what others that are ending as well still send (`ending`); it is served until then;
* ``close()``: called once before it is destroyed, whatever ended it;
* ``inputs``: what the loop serves itself (`Input`): subscriptions, and what is due at a time. The
  executor builds a set of all that there is, twice a message, which takes longer than the message
  does; so where all nodes of a process have inputs it gets a turn now and then, for the rest;
* ``gathers_s``: how long its inputs are left alone after something has come: it takes a few
  messages as fast as one. Where other nodes of the process are served as well, not longer than
  each of them allows.

Several nodes in one process share one thread, so a callback must not wait for what another of
them has yet to do. Of nodes that end together, the one that was made last is closed first.

rclpy's EventsExecutor would take a third less processor time at real time. But it queues an event
a message, also for those that have been taken already: at full speed timers never got their turn,
and a service was answered after 6 s, not 0.6 s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import wraps
from itertools import chain
import signal
import sys
import time
from typing import Any, Protocol

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer

from starcal_ros.config.parameter import ConfigError
from starcal_ros.core import collector
from starcal_ros.core.units import NS
from starcal_ros.messages.cdr import RecordError
from starcal_ros.nodes.base import command_line, ending

LOOK_S = 0.05                   # between looks at the inputs where nothing is said to come
_CALLBACKS = 4                  # of the executor, at most, between two stretches with the inputs
_MANY = 500                     # messages at once: more are coming, and nothing rests
SPIN_S = 0.1                    # longest time until a signal is seen
STATUS_OK, STATUS_FAILED, STATUS_USAGE = 0, 1, 2

USER_ERRORS = (ConfigError, ParameterException, RecordError)
"""What the user can mend: told in one line."""


class Input(Protocol):
    """What the loop serves by itself, without the executor.

    Attributes
    ----------
    handle : object, optional
        That of rclpy whose messages wake the loop; None for what time alone wakes.
    rests_s : float
        How long it need not be looked at from now on, whatever comes; 0 where a message counts.
    """

    @property
    def handle(self) -> Any:
        """See above."""

    @property
    def rests_s(self) -> float:
        """See above."""

    def look_again(self) -> int:
        """Do what there is to do, and return how much it was."""


_ENDING = (signal.SIGINT, signal.SIGTERM, *(
    [signal.SIGHUP] if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN else []))
RCLError = rclpy_implementation.RCLError
_STEADY = Clock(clock_type=ClockType.STEADY_TIME)
_stop_requested_at: float | None = None
_failure: Exception | None = None


def stop_requested() -> bool:
    """Tell whether the process was asked to end; whoever waits must give up then."""
    return _stop_requested_at is not None


def seconds_since_stop() -> float:
    """Return how long ago the process was asked to end, 0 where it was not."""
    return time.monotonic() - _stop_requested_at if _stop_requested_at else 0.0


def request_stop(*_: object) -> None:
    """Ask the process to end, as the signals do; once or more often is the same."""
    global _stop_requested_at
    _stop_requested_at = _stop_requested_at or time.monotonic()


def guarded(callback: Callable[..., None]) -> Callable[..., None]:
    """Return a callback that ends the process in place of raising one of USER_ERRORS.

    An executor would tell more of it than the user can use.
    """
    @wraps(callback)            # rclpy looks at the arguments
    def call(*args: Any) -> None:
        global _failure
        try:
            callback(*args)
        except USER_ERRORS as error:
            _failure = _failure or error
            request_stop()
    return call


def steady_timer(node: Node, period_s: float, callback: Callable[[], None]) -> Timer:
    """Return a guarded timer that real time drives, whatever /clock says to the node."""
    return node.create_timer(period_s, guarded(lambda: callback()), clock=_STEADY)


def end_timer(node: Node, timer: Timer) -> None:
    """End a timer; one that is destroyed, and not cancelled, may fire some more."""
    timer.cancel()
    node.destroy_timer(timer)


def run(make_node: Callable[[], Node], args: list[str] | None = None,
        as_json: Callable[[], Node] | None = None) -> int:
    """Create a node and serve it until a signal comes or it is finished; see `run_together`.

    With ``--json`` it is that of `as_json`, where there is one. A command line with more than
    that and ROS arguments gets help or a refusal.
    """
    given = command_line.words(args)
    if command_line.asks_for_help(given):
        module = make_node.__module__
        print(command_line.help_text(module, sys.modules[module].__doc__,
                                     f'[{command_line.JSON}] ' if as_json else ''))
        return STATUS_OK
    if given == [command_line.JSON] and as_json:
        make_node, given = as_json, []
    if given:
        print(command_line.refusal(given), file=sys.stderr)
        return STATUS_USAGE
    return run_together([make_node], args)


def run_together(make_nodes: Sequence[Callable[[], Node]], args: list[str] | None = None) -> int:
    """Create nodes and serve them until a signal comes or all are finished.

    Parameters
    ----------
    make_nodes : sequence of callables
        Each creates a node, when rclpy is ready.
    args : list of str, optional
        Command line with ROS arguments; ``sys.argv`` by default.

    Returns
    -------
    status : int
        0 after a signal or when the nodes are finished; 1 where one of them has failed; 2 where a
        parameter or a recording is at fault, which is told in one line on stderr. Other exceptions
        are not caught.
    """
    _on_signals(request_stop)
    try:
        _initialize(args)
        made: list[Node] = []
        _serve(make_nodes, made)
    except USER_ERRORS as error:
        print(f'error: {" ".join(str(error).split())}', file=sys.stderr)
        return STATUS_USAGE
    finally:
        rclpy.try_shutdown()
        _on_signals(signal.SIG_IGN)     # while Python itself ends, it would use its own handlers
    return STATUS_FAILED if any(getattr(node, 'failed', False) for node in made) else STATUS_OK


def _on_signals(handler: Any) -> None:
    for number in _ENDING:
        signal.signal(number, handler)


def _initialize(args: list[str] | None) -> None:
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:       # such as a parameter file that cannot be read
        raise ConfigError(f'ROS arguments: {_reason(error)}') from None


def _created(make_node: Callable[[], Node]) -> Node:
    """Create a node; a ConfigError where the middleware gives none."""
    try:
        return make_node()
    except RCLError as error:           # such as a keystore, and a middleware without security
        raise ConfigError(f'no node: {_reason(error)}') from None


def _reason(error: Exception) -> str:
    """Return what rcl says, without its source lines."""
    return str(error).split(', at ')[0]


class _Executor(SingleThreadedExecutor):
    """Waits for inputs as well, and knows whether anything was there when it looked last.

    Attributes
    ----------
    idle : bool
        Whether nothing was.
    """

    def __init__(self) -> None:
        super().__init__()
        self.idle = False
        self._sets: dict[int, Any] = {}         # to wait with, by the number of inputs

    def wait_for_ready_callbacks(self, *args: Any, **kwargs: Any) -> Any:
        """Do as before, and note it."""
        self.idle = True
        found = super().wait_for_ready_callbacks(*args, **kwargs)
        self.idle = False
        return found

    def wait_for(self, inputs: Sequence[Input]) -> None:
        """Wait for a message of any input that does not rest, or the end of a rest, or LOOK_S."""
        handles, timeout_s = [], LOOK_S
        for each in inputs:
            rests_s, handle = each.rests_s, each.handle
            if rests_s > 0.0 or handle is None:
                timeout_s = min(timeout_s, rests_s)
            else:
                handles.append(handle)
        if not handles:                         # an empty set is an error
            time.sleep(timeout_s)
            return
        context = rclpy.get_default_context().handle
        with ExitStack() as held:
            for handle in (*handles, context):
                held.enter_context(handle)
            if len(handles) not in self._sets:
                self._sets[len(handles)] = rclpy_implementation.WaitSet(
                    len(handles), 0, 0, 0, 0, 0, context)
            wait_set = self._sets[len(handles)]
            wait_set.clear_entities()
            for handle in handles:
                wait_set.add_subscription(handle)
            wait_set.wait(int(timeout_s / NS))


def _serve(make_nodes: Sequence[Callable[[], Node]], made: list[Node]) -> None:
    """Serve nodes to their end; those that are made are added to a list."""
    executor, nodes = _Executor(), []
    with ExitStack() as at_the_end:             # the last of these is called first
        at_the_end.callback(executor.shutdown)
        at_the_end.callback(lambda: _end(executor, nodes))
        for make_node in make_nodes:
            nodes.append(_created(make_node))
            executor.add_node(nodes[-1])
            made.append(nodes[-1])
        collector.keep()
        try:
            while nodes:
                _turn(executor, nodes)
                finished = [node for node in nodes if _ends(node)]
                nodes[:] = [node for node in nodes if node not in finished]
                _end(executor, finished)
        except ExternalShutdownException:
            pass
        if _failure is not None:
            raise _failure


def _ends(node: Node) -> bool:
    """Tell whether a node has nothing more to do."""
    if stop_requested():
        ending.announce(node)
        if getattr(node, 'drained', True):
            return True
    return bool(getattr(node, 'finished', False))


def _turn(executor: _Executor, nodes: Sequence[Node]) -> None:
    """Serve nodes for a while, at most SPIN_S where nothing comes."""
    inputs = [getattr(node, 'inputs', ()) for node in nodes]
    if not all(inputs):
        executor.spin_once(timeout_sec=min([SPIN_S, *(
            each.rests_s for each in chain(*inputs) if each.handle is None)]))
        _look_at_all(nodes)
        return
    for _ in range(_CALLBACKS):
        executor.spin_once(timeout_sec=0.0)
        if executor.idle:
            break
    ends, stopped = time.monotonic() + SPIN_S, stop_requested()
    while time.monotonic() < ends and stop_requested() is stopped:
        # Asked for anew: a callback above may have been a transition, which ends subscriptions.
        found = _look_at_all(nodes)
        if not found:
            executor.wait_for([*chain(*(node.inputs for node in nodes))])
        elif found < _MANY and (gathers_s := min(getattr(each, 'gathers_s', 0.0)
                                                 for each in nodes)):
            time.sleep(gathers_s)


def _look_at_all(nodes: Sequence[Node]) -> int:
    """Let all inputs do what there is to do, and return how much it was."""
    return sum(each.look_again() for node in nodes for each in getattr(node, 'inputs', ()))


def _end(executor: SingleThreadedExecutor, nodes: Sequence[Node]) -> None:
    """Close nodes and destroy them, the last first; each of them, whatever the others do."""
    with ExitStack() as stack:
        for node in nodes:
            stack.callback(node.destroy_node)
            stack.callback(executor.remove_node, node)
            stack.callback(getattr(node, 'close', lambda: None))
