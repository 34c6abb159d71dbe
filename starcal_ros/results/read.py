# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Results read again: the calibrated states of a RESULT.json, or of a saved calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from starcal_ros.config import parameter_file
from starcal_ros.config.models import detector
from starcal_ros.config.parameter import ConfigError
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import INTRINSICS_KEYS, Detector
from starcal_ros.files.documents import load_json
from starcal_ros.filter.states import CALIBRATED, EPSILON, N_STATES, UNIT
from starcal_ros.results.initial import CONFIG, RESULT
from starcal_ros.results.document import CalibrationError

_LENS = len(INTRINSICS_KEYS)


@dataclass(frozen=True)
class StoredResult:
    """What a calibration has found.

    Attributes
    ----------
    name : str
        Its file or folder.
    intrinsics : (7,) array
    covariance : (13, 13) or (7, 7) array
        Of the calibrated states in the filter's units, or of the intrinsics alone.
    bias, C_sg : arrays or None
        Gyro bias (3,) [rad/s] and mounting (3, 3); None of a camera alone.
    stamp_ns : int or None
        The last stamp; None where it is not known.
    detector : Detector or None
        None where it is not known.
    verdict, bag_sha256, began_with : str
        '' where they are not known.
    """

    name: str
    intrinsics: Array
    covariance: Array
    bias: Array | None
    C_sg: Array | None
    stamp_ns: int | None
    detector: Detector | None
    verdict: str
    bag_sha256: str
    began_with: str

    @property
    def of_camera(self) -> Array:
        """Covariance of the intrinsics, (7, 7)."""
        return self.covariance[-_LENS:, -_LENS:]


def read_result(path: Path) -> StoredResult:
    """Read a RESULT.json, or the folder of a saved calibration.

    Raises
    ------
    CalibrationError
        Where it can not be read or is no result.
    """
    of: Detector | None = None
    try:
        if path.is_dir():
            of = detector(parameter_file.load(path / CONFIG).camera)
        file = path / RESULT if path.is_dir() else path
        found = load_json(file.read_text(encoding='utf-8'))
        return stored(str(path), found, of)
    except OSError as error:
        raise CalibrationError(f'{path}: cannot be read: {error.strerror}') from None
    except (ConfigError, ValueError, LookupError, TypeError, AttributeError,
            OverflowError) as error:
        raise CalibrationError(f'{path}: is no result of a calibration: '
                               f'{type(error).__name__} {" ".join(str(error).split())}') from None


def stored(name: str, found: Mapping[str, Any], of: Detector | None = None) -> StoredResult:
    """Return what a RESULT.json has found, under a name.

    ValueError, LookupError or TypeError where it is none.
    """
    if 'intrinsics' not in found:
        raise ValueError('of a recording is wanted, with intrinsics and covariance; that of still '
                         'images has a model of its own' if 'parameters' in found
                         else 'it has no intrinsics')
    covariance = np.array(found['covariance'], np.float64)
    if covariance.shape not in ((N_STATES, N_STATES), (_LENS, _LENS)) or (
            not np.isfinite(covariance).all() or (np.diagonal(covariance) < 0.0).any()):
        raise ValueError('its covariance needs 16 x 16 or 7 x 7 finite numbers, no negative '
                         'variance')
    whole = len(covariance) == N_STATES
    if of is None and 'detector' in found:
        of = Detector(int(found['detector']['width']), int(found['detector']['height']),
                      float(found['detector']['pixel_pitch_mm']))
    provenance = found.get('provenance', {})
    return StoredResult(
        name, np.array([float(found['intrinsics'][key]) for key in INTRINSICS_KEYS]),
        covariance[CALIBRATED, CALIBRATED] if whole else covariance,
        np.array(found['gyro_bias_deg_h'], np.float64) * UNIT[EPSILON] if whole else None,
        rotation.to_matrix(np.array(found['mounting']['quaternion_xyzw'], np.float64))
        if whole else None,
        int(found['attitude_final']['stamp_ns']) if whole else None, of,
        str(found.get('verdict', '')), str(provenance.get('bag_sha256', '')),
        str(provenance.get('began_with', '')))
