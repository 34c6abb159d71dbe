# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A calibration in the files of other programs.

* those of the camera, of `camera_files`;
* ``camchain.yaml`` of these with the mounting as Kalibr writes it, ``T_cam_imu`` from gyro to
  optical axes. The stars do not tell the lever arm: it is zero;
* ``imu.yaml``: the gyro as Kalibr reads it, with the bias in addition. There is no accelerometer,
  so its two entries are for the user to add. Kalibr refuses a random walk of zero.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import yaml

from starcal_ros.config.models import detector
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.camera import INTRINSICS_KEYS
from starcal_ros.core.units import DEG_PER_HOUR, DEG_PER_SQRT_HOUR
from starcal_ros.messages import conventions, topics
from starcal_ros.results import camera_files
from starcal_ros.results.camera_files import kalibr
from starcal_ros.results.camera_files.foreign_camera import ForeignCamera

NAMES = (*camera_files.NAMES, 'imu.yaml')

_WALK = 'estimator.process_noise.gyro_bias_deg_h_sqrt_h'
_NAME = 'gyroscope_random_walk'
_UNSEEN = """\
# The bias is stated not to walk, and Kalibr takes no zero. By this walk it would move by its own
# sigma in the time of the calibration, which could not have seen less: measure it (starcal allan).
"""


def files(result: dict[str, Any], scenario: Scenario) -> dict[str, str]:
    """Return the files by name.

    Parameters
    ----------
    result : dict
        A RESULT.json, see `result.result`.
    scenario : Scenario
        That it was made with: its detector, and the noise of its gyro.
    """
    intrinsics = np.array([result['intrinsics'][key] for key in INTRINSICS_KEYS])
    camera = ForeignCamera.of_intrinsics(intrinsics, detector(scenario.camera))
    texts, _ = camera_files.files(camera)           # of T18's lens they all are there
    return {**texts, 'camchain.yaml': _dump({'cam0': _camchain(camera, result, scenario)}),
            'imu.yaml': _imu(result, scenario)}


def _camchain(camera: ForeignCamera, result: dict[str, Any], scenario: Scenario
              ) -> dict[str, Any]:
    q = np.array(result['mounting']['quaternion_xyzw'])
    T_og = np.eye(4)
    T_og[:3, :3] = conventions.optical_in_gyro(rotation.to_matrix(q)).T
    augmented = result.get('augmented', {'names': [], 'estimates': []})
    offset = dict(zip(augmented['names'], augmented['estimates'])).get('tau_s', 0.0) - (
        scenario.star_tracker.time_offset_s)
    return {'T_cam_imu': T_og.tolist(), **(kalibr.camera(camera) or {}),
            # Kalibr's t_imu = t_cam + timeshift: a frame taken at t shows the sky of t + tau
            'timeshift_cam_imu': offset}


def _imu(result: dict[str, Any], scenario: Scenario) -> str:
    walk = _random_walk(result, scenario)
    text = _dump({
        'rostopic': topics.IMU.recorded, 'update_rate': scenario.gyro.rate_hz,
        'gyroscope_noise_density': scenario.gyro.arw_deg_sqrt_h * DEG_PER_SQRT_HOUR,
        _NAME: walk or _unseen_walk(result, scenario),
        'gyroscope_bias': (np.array(result['gyro_bias_deg_h']) * DEG_PER_HOUR).tolist()})
    if not walk:
        text = text.replace(_NAME, _UNSEEN + _NAME)
    return '# Add accelerometer_noise_density and accelerometer_random_walk.\n' + text


def _random_walk(result: dict[str, Any], scenario: Scenario) -> float:
    """Return the random walk of the gyro bias that the filter used, 0 where none [rad/s^1.5]."""
    walk = scenario.estimator.process_noise.gyro_bias_deg_h_sqrt_h
    for level in result['noise_levels']:
        if level['parameter'] == _WALK and level['used']:
            walk = level['value']
    return walk * DEG_PER_HOUR / 60.0


def _unseen_walk(result: dict[str, Any], scenario: Scenario) -> float:
    """Return the random walk that moves the bias by its sigma in this calibration [rad/s^1.5]."""
    duration_s = result['counts']['gyro'] / scenario.gyro.rate_hz
    return float(max(result['gyro_bias_sigma_deg_h']) * DEG_PER_HOUR / np.sqrt(duration_s))


def _dump(tree: dict[str, Any]) -> str:
    text: str = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)
    return text
