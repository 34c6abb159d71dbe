# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What an estimator would have said at the end of a calibration, out of its RESULT.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from starcal_ros.core import rotation
from starcal_ros.files.documents import load_json
from starcal_ros.filter.states import CALIBRATED, STATE_NAMES
from starcal_ros.core.verdict_words import INCONSISTENT, LOST, NOT_YET
from starcal_ros.live import facts
from starcal_ros.live.heard import Seen
from starcal_ros.results.initial import RESULT
from starcal_ros.results.read import read_result
from starcal_ros.results.document import CalibrationError


def finished(path: Path) -> Seen:
    """Return what a RESULT.json, or the folder of a saved calibration, says.

    Raises
    ------
    CalibrationError
        Where it can not be read, or is no result of a whole calibration.
    """
    stored = read_result(path)
    file = path / RESULT if path.is_dir() else path
    found = load_json(file.read_text(encoding='utf-8'))
    if stored.C_sg is None or stored.bias is None or stored.stamp_ns is None:
        raise CalibrationError(f'{path}: is of a camera alone; starcal serve shows what starcal '
                               'calibrate found')
    try:
        C_ig = rotation.to_matrix(np.array(found['attitude_final']['quaternion_xyzw'], np.float64))
        state = np.concatenate((
            [stored.stamp_ns * 1e-9], rotation.log(C_ig), stored.bias,
            rotation.to_fixed_angles(stored.C_sg), stored.intrinsics,
            np.array(found['covariance'], np.float64).ravel()))
        seen = Seen(state, level=2 if stored.verdict in (INCONSISTENT, LOST) else 0,
                    values=_values(found), silent_s=0.0)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise CalibrationError(f'{path}: is no result of a calibration: '
                               f'{type(error).__name__} {" ".join(str(error).split())}') from None
    if stored.detector is not None:
        seen.size = stored.detector.width, stored.detector.height
    seen.message = _message(seen, stored.verdict)
    return seen


def _message(seen: Seen, word: str) -> str:
    """Return a verdict as the estimator would have said it, but for the test that fails."""
    outside = [state.name for state in facts.states(seen)[CALIBRATED] if not state.within]
    parts = [', '.join(outside) if word == NOT_YET else '', facts.advice(seen)]
    return ': '.join(filter(None, (word, '; '.join(filter(None, parts)))))


def _values(found: dict[str, Any]) -> dict[str, str]:
    """Return the diagnostics that the estimator would have published with a result."""
    wanted = found['tolerance']
    u, v = found['reprojection_rms_px']
    tolerance = [*wanted['gyro_bias_sigma_deg_h'], *wanted['mounting']['sigma_arcsec'],
                 *wanted['intrinsics_sigma'].values()]
    numbers = {f'tolerance_{name}': value
               for name, value in zip(STATE_NAMES[CALIBRATED], tolerance, strict=True)}
    numbers |= {'reprojection_rms_u_px': u, 'reprojection_rms_v_px': v}
    for test in found['consistency']:
        key = str(test['name']).lower().replace(' ', '_')
        numbers |= {key: test['value'], f'{key}_low': test['low'], f'{key}_high': test['high']}
    alike = '; '.join(f'{", ".join(each["states"])} ({each["reason"]}): {each["advice"]}'
                      for each in found['not_told_apart'])
    return {**{name: f'{float(number):.6g}' for name, number in numbers.items()},
            **{str(name): str(count) for name, count in found['counts'].items()},
            'verdict': str(found['verdict']), 'advice': str(found['advice']) or 'none',
            'not_told_apart': alike or 'none'}
