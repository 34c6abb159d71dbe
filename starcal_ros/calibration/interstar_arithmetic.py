# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The interstar equations of a pinhole camera: compiled where numba is installed, else reduced.

The first import compiles: at installation, by
`python -m starcal_ros.calibration.interstar_arithmetic`.
"""

from __future__ import annotations

from starcal_ros.core.compiled import say_uncompiled

try:
    from starcal_ros.calibration.interstar_kernel import pinhole_equations
except Exception as error:
    say_uncompiled('the self-calibration', error)
    from starcal_ros.calibration.interstar_complete import pinhole_equations

__all__ = ['pinhole_equations']
