# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How a launch ends by itself: for the launch files, with launch alone, no node of its own.

When the run or the replay is over, each node that is left is asked to end when those that speak to
it have ended, so that it has all that they said. A node that fails ends the launch at once, with
status 1: the others would wait for it. What else a launch runs, that includes the file, is left
alone: launch itself ends when nothing runs any more.

launch is imported when it is used: the nodes do without it.
"""

from __future__ import annotations

from collections.abc import Sequence
import signal
from typing import Any

STATUS_FAILED = 1       # of a node that could not go on; see `run_loop`
IN_PEACE = {'sigterm_timeout': '60'}
"""What launch is told of each node, which it would else kill 10 s after Ctrl-C: `ending`."""


class Ending:
    """Answers to the end of each node.

    Parameters
    ----------
    sources : sequence of Node
        When all of them have ended, the run is over; without any it never is.
    others : sequence of Node
        The other nodes, each before those that it speaks to.
    linger : bool, optional
        Whether these stay when the run is over.
    spare : Node, optional
        One of the others that may fail while these go on.
    """

    def __init__(self, sources: Sequence[Any], others: Sequence[Any], linger: bool = False,
                 spare: Any = None) -> None:
        self.sources, self.others, self.linger, self.spare = sources, others, linger, spare
        self._failed = ''
        self._ended: list[Any] = []
        self._over = False

    def __call__(self, event: Any, context: Any) -> list[Any]:
        """Return what is to be done now."""
        from launch.actions import EmitEvent, Shutdown
        from launch.events import matches_action
        from launch.events.process import SignalProcess
        own = (*self.sources, *self.others)
        if context.is_shutdown or event.action not in own:
            return []
        name = event.process_name
        if event.returncode != 0:
            self._failed = f'{name} ended with status {event.returncode}'
            if event.action is not self.spare or event.returncode != STATUS_FAILED:
                raise RuntimeError(self._failed)
        self._ended.append(event.action)
        if event.action is self.spare and self._failed and not self._over:
            return []
        if event.action in self.others and not self._over:
            return [Shutdown(reason=f'{name} ended')]
        if not self.sources or not all(each in self._ended for each in self.sources):
            return []
        if self.linger:
            return []
        self._over = True
        for node in self.others:
            if node.process_details is not None and node not in self._ended:
                return [EmitEvent(event=SignalProcess(
                    signal_number=signal.SIGINT, process_matcher=matches_action(node)))]
        if self._failed:
            raise RuntimeError(self._failed)
        return []


def end_in_turn(sources: Sequence[Any], others: Sequence[Any], linger: Any = None,
                spare: Any = None) -> Any:
    """Return the action for a launch description; see `Ending`.

    The launch configuration `linger` is read when the description is: where a group includes it,
    its arguments are gone by the time that a node ends.
    """
    from launch.actions import OpaqueFunction, RegisterEventHandler
    from launch.event_handlers import OnProcessExit

    def begin(context: Any) -> list[Any]:
        stays = linger is not None and linger.perform(context).lower() in ('true', '1')
        return [RegisterEventHandler(OnProcessExit(
            on_exit=Ending(sources, others, stays, spare)))]
    return OpaqueFunction(function=begin)
