# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled arithmetic of a frame without an attitude, `kernel`; None where numba is absent.

The first import compiles: at installation, by
`python -m starcal_ros.calibration.frame_arithmetic`.
"""

from __future__ import annotations

from types import ModuleType

from starcal_ros.core.compiled import say_uncompiled

kernel: ModuleType | None
try:
    from starcal_ros.calibration import frame_kernel as kernel
except Exception as error:
    say_uncompiled('the calibration by single frames', error)
    kernel = None
