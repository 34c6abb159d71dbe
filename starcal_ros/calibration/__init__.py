# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The camera alone: methods found by name, and the mathematics that they stand on.

Each module of `methods` has ``start(scenario, known=None)``, which returns a
`method.CameraMethod`: gyro samples and frames in the order of their stamps go in, a camera with
its covariance comes out. It begins at the nominal camera with the initial sigmas, or at what is
known from other frames. What all methods must do is tested in
``test/calibration/test_methods.py``, which finds them here.
"""

from __future__ import annotations

from functools import partial
from importlib import import_module
import pkgutil

from starcal_ros.calibration import methods
from starcal_ros.calibration.camera_calibrator import CameraCalibrator
from starcal_ros.calibration.method import CameraMethod
from starcal_ros.config.models import own_focal_sigma_mm
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.camera_estimate import CameraEstimate


def names() -> list[str]:
    """Return the methods there are."""
    return sorted(module.name for module in pkgutil.iter_modules(methods.__path__))


def begin(scenario: Scenario, known: CameraEstimate | None = None) -> CameraMethod:
    """Begin the method ``intrinsics.method``, for messages with increasing stamps.

    Parameters
    ----------
    scenario : Scenario
    known : CameraEstimate, optional
        In place of the nominal camera and its initial sigmas, from other frames.

    Raises
    ------
    ConfigError
        Where there is no such method, or it has no focal length for each frame.
    """
    name = scenario.intrinsics.method
    if name not in names():
        raise ConfigError(f'intrinsics.method: got {name!r}, allowed are {", ".join(names())}')
    own_focal_sigma_mm(scenario)        # says what can not go together
    begun: CameraMethod = import_module(f'{methods.__name__}.{name}').start(scenario, known)
    return begun


def start(scenario: Scenario, known: CameraEstimate | None = None) -> CameraCalibrator:
    """Begin the method ``intrinsics.method``, for messages as they arrive; else as `begin`."""
    return CameraCalibrator(scenario, partial(begin, scenario, known))
