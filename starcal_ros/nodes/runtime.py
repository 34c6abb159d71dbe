# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Run one node from its creation to a clean end: the body of every `main`.

SIGINT and SIGTERM only set a flag. The loop below and all that waits (`starcal_ros.nodes.flow`)
look at it, so a node is never interrupted halfway: it closes its file, leaves the graph and
exits with status 0. With rclpy's own handlers some exits, too early or too late a Ctrl-C, end
in a traceback.

A node may have

* ``finished``: true when it has nothing left to do, which ends the process;
* ``close()``: called once before it is destroyed, whatever ended it.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from starcal_ros.cdr import RecordError
from starcal_ros.parameter import ConfigError

SPIN_S = 0.1                    # longest time until a signal is seen
STATUS_OK, STATUS_USAGE = 0, 2

_USER_ERRORS = (ConfigError, ParameterException, RecordError)
_stop_requested_at: float | None = None


def stop_requested() -> bool:
    """Tell whether the process was asked to end; whoever waits must give up then."""
    return _stop_requested_at is not None


def seconds_since_stop() -> float:
    """Return how long ago the process was asked to end, 0 where it was not."""
    return time.monotonic() - _stop_requested_at if _stop_requested_at else 0.0


def request_stop(*_: object) -> None:
    """Ask the process to end, as SIGINT and SIGTERM do; once or more often is the same."""
    global _stop_requested_at
    _stop_requested_at = _stop_requested_at or time.monotonic()


def run(make_node: Callable[[], Node], args: list[str] | None = None) -> int:
    """Create a node and serve it until a signal comes or it is finished.

    Parameters
    ----------
    make_node : callable
        Creates the node, when rclpy is ready.
    args : list of str, optional
        Command line with ROS arguments; ``sys.argv`` by default.

    Returns
    -------
    status : int
        0 after a signal or when the node is finished; 2 where a parameter or a recording is at
        fault, which is told in one line on stderr. Other exceptions are not caught.
    """
    _on_signals(request_stop)
    try:
        _initialize(args)
        _serve(make_node)
    except _USER_ERRORS as error:
        print(f'error: {" ".join(str(error).split())}', file=sys.stderr)
        return STATUS_USAGE
    finally:
        rclpy.try_shutdown()
        _on_signals(signal.SIG_IGN)     # while Python itself ends, it would use its own handlers
    return STATUS_OK


def _on_signals(handler: Any) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def _initialize(args: list[str] | None) -> None:
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:       # such as a parameter file that cannot be read
        reason = str(error).split(', at ')[0]       # without rcl's source lines
        raise ConfigError(f'ROS arguments: {reason}') from None


def _serve(make_node: Callable[[], Node]) -> None:
    node = make_node()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not (stop_requested() or getattr(node, 'finished', False)):
            executor.spin_once(timeout_sec=SPIN_S)
    except ExternalShutdownException:
        pass
    finally:
        try:
            getattr(node, 'close', lambda: None)()
        finally:
            executor.shutdown()
            node.destroy_node()
