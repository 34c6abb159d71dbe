# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes: thin shells around the core, and what they share."""

import sys
from types import TracebackType

_show = sys.excepthook


def _show_no_interrupt(kind: type[BaseException], value: BaseException,
                       trace: TracebackType | None) -> None:
    # A Ctrl-C while a node is still importing: `runtime.run` has no say yet.
    if not issubclass(kind, KeyboardInterrupt):
        _show(kind, value, trace)


sys.excepthook = _show_no_interrupt
