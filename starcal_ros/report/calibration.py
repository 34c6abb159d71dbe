# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""All that the report of a calibration is made of, and what of it stands at the top."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.config.models import intrinsics, mounting_matrix, of_calibrated
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import INTRINSICS_KEYS
from starcal_ros.core.statistic import Statistic
from starcal_ros.core.units import NS
from starcal_ros.core.utc import utc_text
from starcal_ros.filter.history import History
from starcal_ros.filter.states import CALIBRATED, EPSILON, UNIT
from starcal_ros.filter.verdict import Verdict

NOMINAL = 'nominal values'
"""What a calibration begins with where nothing is saved, in the provenance of its result."""


class Calibration(NamedTuple):
    """All that the report is made of.

    Attributes
    ----------
    outcome : dict
        RESULT.json.
    truth : dict or None
        truth.json, where it is known.
    history : History
        How it came about.
    verdict : Verdict
        On the final estimate.
    scenario : Scenario
        Configuration that it was made with, the values that it began with as its nominal ones.
    notices : list of str
        What a user should know.
    tests : sequence of (int, tuple of Statistic)
        What the tests of the innovations were on the way, by their stamps.
    prior : (13, 13) array or None
        Covariance of what it began with; None for the initial sigmas.
    command : str
        That was given.
    """

    outcome: dict[str, Any]
    truth: dict[str, Any] | None
    history: History
    verdict: Verdict
    scenario: Scenario
    notices: list[str]
    tests: Sequence[tuple[int, tuple[Statistic, ...]]] = ()
    prior: Array | None = None
    command: str = ''

    @property
    def camera(self) -> Array:
        """The intrinsics that were found, (7,)."""
        return camera_of(self.outcome)

    @property
    def began(self) -> Array:
        """Values that it began with, (13,), in the filter's units; the mounting as no rotation."""
        bias = np.array(self.scenario.gyro.bias_deg_h) * UNIT[EPSILON]
        return np.concatenate((bias, np.zeros(3), intrinsics(self.scenario.camera)))

    @property
    def change(self) -> Array:
        """What was found less what it began with, (13,), in the units of sigmas."""
        C_found = rotation.to_matrix(np.array(self.outcome['mounting']['quaternion_xyzw']))
        turn = rotation.log(C_found @ mounting_matrix(self.scenario.mounting).T)
        bias = np.array(self.outcome['gyro_bias_deg_h']) * UNIT[EPSILON]
        return np.asarray((np.concatenate((bias, turn, self.camera)) - self.began)
                          / UNIT[CALIBRATED])

    @property
    def prior_sigma(self) -> Array:
        """Sigmas of what it began with, (13,), in the units of sigmas."""
        if self.prior is not None:
            return np.sqrt(np.diag(self.prior)) / UNIT[CALIBRATED]
        return of_calibrated(self.scenario.estimator.initial_sigma)


def camera_of(side: dict[str, Any]) -> Array:
    """Return the intrinsics of a result or a truth, (7,)."""
    return np.array([side['intrinsics'][key] for key in INTRINSICS_KEYS])


def facts(calibration: Calibration) -> list[tuple[str, str]]:
    """Return what stands at the top: when, how long, which camera, which command."""
    stamps, camera = calibration.history.stamp_ns, calibration.scenario.camera
    seconds = (int(stamps[-1]) - int(stamps[0])) * NS
    size = np.array([camera.width, camera.height]) * camera.pixel_pitch_mm
    field = np.degrees(2.0 * np.arctan(0.5 * size / calibration.camera[2]))
    provenance = calibration.outcome['provenance']
    return [
        ('Recorded', f'{utc_text(int(stamps[0]))} to {utc_text(int(stamps[-1]))} UTC, '
         f'{duration(seconds)}'),
        ('Camera', f'{camera.width} × {camera.height} px of {1e3 * camera.pixel_pitch_mm:g} µm, '
         f'f = {calibration.camera[2]:.4g} mm, {field[0]:.3g}° × {field[1]:.3g}°'),
        ('Began with', provenance.get('began_with', NOMINAL)),
        *made(calibration.command, provenance.get('version', ''))]


def made(command: str, version: str) -> list[tuple[str, str]]:
    """Return when a page was made, and how."""
    now = datetime.now(timezone.utc).strftime('%Y-%m-%dT%H:%M:%S')
    return [('Page made', f'{now} UTC' + (f', starcal_ros {version}' if version else '')),
            *([('Command', command)] if command else [])]


def called(path: str) -> str:
    """Return the name of a file or folder, whatever way leads to it: that of ``.`` as well."""
    return Path(path).resolve().name or path


def duration(seconds: float) -> str:
    """Return a time as people write it."""
    if seconds < 120.0:
        return f'{seconds:.1f} s'
    if seconds < 7200.0:
        return f'{seconds / 60.0:.1f} min'
    return f'{seconds / 3600.0:.2f} h'
