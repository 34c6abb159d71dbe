# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The truth that a simulated recording carries, where it is one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from starcal_ros.core.camera import INTRINSICS_KEYS
from starcal_ros.files.documents import DocumentError, load_json
from starcal_ros.recording.reader import TRUTH_ATTACHMENT

_LARGEST = 1e12         # of any value of the truth, in the units of RESULT.json


def attached_truth(attachments: Mapping[str, bytes]) -> tuple[dict[str, Any] | None, list[str]]:
    """Return the truth of a recording, under the names of RESULT.json.

    Parameters
    ----------
    attachments : mapping of bytes
        Of the recording, by name.

    Returns
    -------
    truth : dict or None
        None where there is none, or none that can be read.
    notices : list of str
        Why it can not be read.
    """
    if TRUTH_ATTACHMENT not in attachments:
        return None, []
    try:
        return _truth(load_json(attachments[TRUTH_ATTACHMENT])), []
    except (DocumentError, LookupError, TypeError, ValueError, OverflowError) as error:
        what = f'{error}' if isinstance(error, DocumentError) else (
            f'{type(error).__name__} {error}')
        return None, [f"the recording's {TRUTH_ATTACHMENT} is left out: {what[:200]}"]


def _truth(side: Any) -> dict[str, Any]:
    mounting = side['mounting']
    quaternion = _numbers(mounting['quaternion_xyzw'], 4)
    if not np.linalg.norm(quaternion) > 0.1:
        raise ValueError('mounting.quaternion_xyzw is no rotation')
    intrinsics = _numbers([side['intrinsics'][key] for key in INTRINSICS_KEYS], 7)
    return {'intrinsics': dict(zip(INTRINSICS_KEYS, intrinsics)),
            'gyro_bias_deg_h': _numbers(side['gyro_bias_deg_h'], 3),
            'mounting': {'quaternion_xyzw': quaternion,
                         'fixed_angles_deg': _numbers(mounting['fixed_angles_deg'], 3)}}


def _numbers(values: Any, count: int) -> list[float]:
    if not isinstance(values, list) or len(values) != count or not all(
            isinstance(value, (int, float)) and abs(value) < _LARGEST for value in values):
        raise ValueError(f'{count} numbers expected')
    return [float(value) for value in values]
