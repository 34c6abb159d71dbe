# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The camera alone: methods found by name, and the mathematics that they stand on.

Each module of `methods` has ``start(scenario, known=None)``, which returns a
`camera_estimate.CameraMethod`: gyro samples and frames go in, a camera with its covariance comes
out. It begins at the nominal camera with the initial sigmas, or at what is known from other
frames. What all methods must do is tested in ``test/test_methods.py``, which finds them here.
"""

from __future__ import annotations

from importlib import import_module
import pkgutil

from starcal_ros.calibration import methods
from starcal_ros.calibration.method import CameraMethod
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.camera_estimate import CameraEstimate


def names() -> list[str]:
    """Return the methods there are."""
    return sorted(module.name for module in pkgutil.iter_modules(methods.__path__))


def start(scenario: Scenario, known: CameraEstimate | None = None) -> CameraMethod:
    """Begin a calibration by the method ``intrinsics.method``.

    Parameters
    ----------
    scenario : Scenario
    known : CameraEstimate, optional
        In place of the nominal camera and its initial sigmas, from other frames.

    Raises
    ------
    ConfigError
        Where there is no such method.
    """
    method = scenario.intrinsics.method
    if method not in names():
        raise ConfigError(f'intrinsics.method: got {method!r}, allowed are {", ".join(names())}')
    begun: CameraMethod = import_module(f'{methods.__name__}.{method}').start(
        scenario, known)
    return begun
