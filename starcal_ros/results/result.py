# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The outcome of a calibration: RESULT.json, and the camera's part of it alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

import starcal_ros
from starcal_ros.config.scenario import Scenario
from starcal_ros.core import rotation
from starcal_ros.core.arrays import Array
from starcal_ros.core.camera import INTRINSICS_KEYS, Detector
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.filter import verdict
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.explanations import Explanations
from starcal_ros.filter.progress import Progress
from starcal_ros.filter.states import CALIBRATED, EPSILON, LENS, PSI, UNIT
from starcal_ros.recording.reader import Recording
from starcal_ros.recording.recording_stream import RecordingStream
from starcal_ros.results.document import CalibrationError


def word(calibrator: Calibrator) -> str:
    """Return the verdict on a calibration in one of its four words."""
    belief = calibrator.belief
    known = belief is not None and bool(
        (belief.sigma[CALIBRATED] <= calibrator.filter.tolerance).all())
    return verdict.word(known, calibrator.tracking, calibrator.consistency.statistics())


def result(calibrator: Calibrator, provenance: dict[str, str],
           progress: Progress | None = None, explained: Explanations | None = None
           ) -> dict[str, Any]:
    """Return RESULT.json as a dictionary.

    Parameters
    ----------
    calibrator : Calibrator
        After its last frame.
    provenance : dict
        Version, configuration hash, bag hash.
    progress : Progress, optional
        How the run went; without it ``advice`` says nothing of the time that it will take.
    explained : Explanations, optional
        What would explain data that contradict the model.

    Returns
    -------
    dict
        ``covariance`` is that of the 16 states of `error_state` in its units: rad, rad/s, rad, px,
        px, mm, mm^-2, mm^-4, mm^-1, mm^-1. ``attitude_final`` is the integrated attitude at the
        last gyro sample. ``consistency`` has each test of the innovations with its band, and
        ``variance_factor`` how much larger than stated the variances are of what a turn of the
        camera explains, and of the rest; ``changes`` has the steps and drifts that were answered.
        ``noise_levels`` has those of ``estimator.adapt``: stated and found, with the sigma of
        what was found, and whether it was used. ``tolerance`` has the largest sigmas that are
        wanted, with the names and units of the sigmas; ``advice`` is a text, empty where nothing
        is to be done; ``not_told_apart`` has for each group of such states their names, the
        reason and what would help. ``augmented`` is there where states of `augmentation` are on:
        their names, each with its unit, estimates and sigmas. ``explanations`` is there where
        extensions of the model were tried: what to add to the parameter file for each, the best
        first (`filter.explanations`).

    Raises
    ------
    CalibrationError
        Where no frame has given an attitude.
    """
    belief = calibrator.belief
    if belief is None:
        raise CalibrationError(no_attitude(calibrator))
    estimate, sigma = belief.estimate, belief.sigma / UNIT
    stamp_ns, C_gi = calibrator.attitude_now()
    counts, judged = calibrator.counts, verdict.of(calibrator, progress)
    tolerance = np.array([state.tolerance for state in judged.states])
    turns, centroids = calibrator.consistency.variance_factors()
    values = {
        'intrinsics': _named(estimate.intrinsics),
        'intrinsics_sigma': _named(sigma[LENS]),
        'gyro_bias_deg_h': (estimate.bias / UNIT[EPSILON]).tolist(),
        'gyro_bias_sigma_deg_h': sigma[EPSILON].tolist(),
        'mounting': {
            'quaternion_xyzw': rotation.to_quaternion(estimate.C_sg).tolist(),
            'fixed_angles_deg': np.degrees(rotation.to_fixed_angles(estimate.C_sg)).tolist(),
            'sigma_arcsec': sigma[PSI].tolist(),
        },
        'covariance': belief.covariance.tolist(),
        'detector': of_detector(calibrator.filter.detector),
        'reprojection_rms_px': calibrator.reprojection_rms_px.tolist(),
        'attitude_final': {
            'stamp_ns': stamp_ns,
            'quaternion_xyzw': rotation.to_quaternion(C_gi.T).tolist(),
        },
        'verdict': judged.word,
        'converged': judged.converged,
        'consistency': [{**each._asdict(), 'passed': each.passed} for each in judged.statistics],
        'variance_factor': {'turns': turns, 'centroids': centroids},
        'changes': [{**change._asdict(), 'what': list(change.what), 'sigma': [
            sigma if np.isfinite(sigma) else None for sigma in change.sigma],
            'sentence': change.sentence} for change in calibrator.consistency.changes],
        'noise_levels': [{
            'parameter': each.key, 'stated': each.stated, 'value': each.value,
            'sigma': each.value * each.spread if np.isfinite(each.spread) else None,
            'used': each.used, 'sentence': each.sentence} for each in calibrator.noise.levels()],
        'tolerance': {
            'intrinsics_sigma': _named(tolerance[6:]),
            'gyro_bias_sigma_deg_h': tolerance[:3].tolist(),
            'mounting': {'sigma_arcsec': tolerance[3:6].tolist()},
        },
        'advice': judged.advice,
        'not_told_apart': [{'states': list(each.names), 'reason': each.reason,
                            'advice': each.advice} for each in judged.couplings],
        'counts': dataclasses.asdict(counts),
        'provenance': provenance,
    }
    if explained is not None:
        values['explanations'] = {
            'sentence': explained.sentence, 'stretch_s': explained.stretch_s,
            'to_adopt': explained.to_adopt.name if explained.to_adopt else None,
            'tried': [{'name': each.name, 'parameters': dict(each.values),
                       'lines': list(each.lines), 'numbers': each.numbers, 'gain': each.gain,
                       'score': each.score, 'beyond_chance': each.beyond_chance}
                      for each in explained.tried]}
    if estimate.augmentation.on:
        units = estimate.augmentation.units
        values['augmented'] = {'names': list(estimate.augmentation.names),
                               'estimates': (estimate.augmented / units).tolist(),
                               'sigmas': (belief.augmented_sigma / units).tolist()}
    return values


def camera(estimate: CameraEstimate) -> dict[str, Any]:
    """Return what is known of a camera: the names of RESULT.json, the covariance that of seven."""
    return {
        'intrinsics': _named(estimate.intrinsics),
        'intrinsics_sigma': _named(estimate.sigma),
        'covariance': estimate.covariance.tolist(),
        'counts': {'frames': estimate.frames, 'stars': estimate.stars},
    }


def of_detector(detector: Detector) -> dict[str, Any]:
    """Return what the intrinsics are counted on: the pixels of a camera."""
    return {'width': detector.width, 'height': detector.height,
            'pixel_pitch_mm': detector.pitch_mm}


def provenance(scenario: Scenario, recording: Recording | RecordingStream) -> dict[str, str]:
    """Return where a result comes from: version, configuration hash, bag hash."""
    return {'version': starcal_ros.__version__, 'config_sha256': scenario.sha256,
            'bag': str(recording.path), 'bag_sha256': recording.sha256}


def no_attitude(calibrator: Calibrator) -> str:
    """Say why there is nothing to report."""
    counts = calibrator.counts
    return (f'no attitude from any frame: {counts.gyro} gyro readings, {counts.frames} frames '
            f'reached by them ({counts.empty_frames} without a usable star, '
            f'{counts.unusable_stars} stars unusable), {calibrator.waiting} frames waiting for '
            'gyro')


def _named(values: Array) -> dict[str, float]:
    return dict(zip(INTRINSICS_KEYS, values.tolist()))
