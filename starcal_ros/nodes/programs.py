# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The programs of the nodes: ``ros2 run starcal_ros NAME``, or ``python -m`` this module and NAME.

A node takes a second to import. Python would answer a Ctrl-C in that time with a KeyboardInterrupt
wherever the import stands: importlib loses some of them, so that the node goes on, and extension
modules turn others into an ImportError. Up to `run_loop.run`, which has handlers of its own,
the signal therefore ends the process as it ends one that is not written in Python.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
import os
import signal
import sys

from starcal_ros.config import middleware
from starcal_ros.core.collector import look_seldom


def _program(name: str) -> Callable[[], int]:
    def main() -> int:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.environ.update(middleware.profile())
        look_seldom()
        status: int = import_module(f'starcal_ros.nodes.{name}').main()
        return status
    return main


centroid_extractor = _program('centroid_extractor')
composed = _program('composed')
display = _program('display')
estimator = _program('estimator')
gyro_sim = _program('gyro_sim')
intrinsics_estimator = _program('intrinsics_estimator')
player = _program('player')
recorder = _program('recorder')
serve = _program('serve')
star_identifier = _program('star_identifier')
star_tracker_sim = _program('star_tracker_sim')
watch = _program('watch')

if __name__ == '__main__':
    sys.exit(globals()[sys.argv.pop(1)]())
