# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a calibration begins with: the nominal values, or where a saved one ended.

A saved calibration gives its values in place of the nominal ones and its covariance in place of
``estimator.initial_sigma``. The attitude is found afresh, so how it hangs together with the rest
is left out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from starcal_ros.config import parameter_file
from starcal_ros.config.models import detector
from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import Scenario, from_flat
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import INTRINSICS_KEYS
from starcal_ros.files.documents import load_json
from starcal_ros.filter.states import CALIBRATED, N_STATES
from starcal_ros.results import export
from starcal_ros.results.document import CalibrationError, dumps
from starcal_ros.results.store import CalibrationStore

RESULT, CONFIG = 'result.json', 'config.yaml'

_ROUNDING = 1e-9        # by which correlations may be off


class InitialValues(NamedTuple):
    """What a `Calibrator` begins with.

    Attributes
    ----------
    scenario : Scenario
        With the values to begin with.
    covariance : (13, 13) array or None
        Of the calibrated states, in the filter's units; None for the initial sigmas.
    source : str
        Folder of the saved calibration; '' for the nominal values.
    notices : tuple of str
        What a user should know.
    """

    scenario: Scenario
    covariance: Array | None = None
    source: str = ''
    notices: tuple[str, ...] = ()


def files(result: dict[str, Any], scenario: Scenario) -> dict[str, str]:
    """Return what is saved of a calibration: itself, its configuration, the files for others."""
    return {RESULT: dumps(result), CONFIG: parameter_file.dump(scenario),
            **export.files(result, scenario)}


def initial_values(scenario: Scenario, archive: CalibrationStore) -> InitialValues:
    """Return what to begin with, as ``estimator.load_calibration`` says.

    A calibration that can not be used is passed over for the one before it, with a notice.
    """
    if not scenario.estimator.load_calibration:
        return InitialValues(scenario)
    notices: list[str] = []
    for folder in archive.folders():
        try:
            found = load(folder, scenario)
        except CalibrationError as error:
            notices.append(f'not loaded: {error}')
        else:
            return found._replace(notices=(*notices, f'beginning with the calibration {folder}'))
    notices.append(f'{archive.directory} has no calibration: beginning with the nominal values')
    return InitialValues(scenario, notices=tuple(notices))


def load(folder: Path, scenario: Scenario) -> InitialValues:
    """Read a saved calibration.

    Raises
    ------
    CalibrationError
        Where it can not be read, or is of another detector.
    """
    try:
        of = detector(parameter_file.load(folder / CONFIG).camera)
        result = load_json((folder / RESULT).read_text(encoding='utf-8'))
        found = _start(result, scenario, str(folder))
    except OSError as error:
        raise CalibrationError(f'{folder}: cannot be read: {error.strerror}') from None
    except (ConfigError, ValueError, LookupError, TypeError, OverflowError) as error:
        raise CalibrationError(f'{folder}: is no calibration: {error}') from None
    if of != detector(scenario.camera):
        raise CalibrationError(f'{folder}: is of a detector of {of.width} x {of.height} pixels of '
                               f'{of.pitch_mm} mm, this one is not')
    return found


def _start(result: dict[str, Any], scenario: Scenario, source: str) -> InitialValues:
    u0, v0, f, *distortion = (result['intrinsics'][key] for key in INTRINSICS_KEYS)
    values = {key: value for key, value in scenario.flat().items()
              if not key.startswith('mounting.')}
    covariance = np.array(result['covariance'], np.float64)
    if (covariance.shape != (N_STATES, N_STATES) or not np.isfinite(covariance).all()
            or (np.diagonal(covariance) <= 0.0).any()):
        raise ValueError('covariance: needs 16 x 16 finite numbers, variances above 0')
    sigma = np.sqrt(np.diagonal(covariance))
    correlation = covariance / sigma / sigma[:, None]
    if (np.abs(correlation - correlation.T).max() > _ROUNDING
            or np.linalg.eigvalsh(correlation)[0] < -_ROUNDING):
        raise ValueError('covariance: is not symmetric and positive definite')
    return InitialValues(from_flat({
        **values, 'camera.principal_point_px': [u0, v0], 'camera.focal_length_mm': f,
        'camera.distortion': distortion,
        'mounting.quaternion_xyzw': result['mounting']['quaternion_xyzw'],
        'gyro.bias_deg_h': result['gyro_bias_deg_h']}), covariance[CALIBRATED, CALIBRATED], source)
