# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""How often Python looks for cycles of garbage: seldom, in the processes of this package.

Nearly all that is made here goes when the last one who knows it does. By default Python looks for
the rest after every 700 new objects, and each time anew through much of what the libraries hold:
a tenth of a calibration's time, and a pause of a tenth of a second within a node.
"""

from __future__ import annotations

import gc

_NEW_OBJECTS = 20_000           # a few megabytes, were they garbage


def look_seldom() -> None:
    """Look for garbage after many more new objects than by default; of this process, for good."""
    gc.set_threshold(_NEW_OBJECTS, 20, 20)


def keep() -> None:
    """Take all that is there for what stays: it is not looked through again."""
    gc.freeze()
