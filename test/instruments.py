# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The instrument that most tests calibrate, T18's, and where the skies of others are.

All is read of the shipped file, whose numbers `test_parameter_file.py` holds against the paper's.
"""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

from starcal_ros.calibration import invariants
from starcal_ros.config import models, parameter_file
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.simulation import sensors

TOP = Path(__file__).resolve().parents[1]
CONFIG = TOP / 'config' / 'tan2018.yaml'
TAN2018 = parameter_file.load(CONFIG)

DETECTOR = models.detector(TAN2018.camera)
PITCH_MM = DETECTOR.pitch_mm
INTRINSICS = models.intrinsics(TAN2018.camera, TAN2018.truth.camera)
"""The true ones, T18 Table 1: 3 px of distortion at the corner."""
INTRINSICS.flags.writeable = False
LENS = invariants.Lens(PITCH_MM, steps=2)

_DATA = TOP.parent / 'shared' / 'data'
EXTERNAL = _DATA / 'external_tan2018'
"""A recording by others of the same instrument; not part of the checkout."""
REAL_SKY = _DATA / 'real_sky'
"""Folders of real images with their stars; not part of the checkout."""


def calibrated(stated, simulated=None, spoil=None):
    """Return the calibrator of a scenario after the messages of another, or of spoilt ones."""
    simulated = simulated or stated
    gyro, tracker = sensors.gyro(simulated), sensors.star_tracker(simulated)
    samples, frames = gyro.next(gyro.count), tracker.next(tracker.count)
    if spoil:
        samples, frames = spoil(samples, frames)
    calibrator = Calibrator(stated)
    calibrator.add_gyro(samples)
    calibrator.add_frames(frames)
    for _ in calibrator.process():
        pass
    return calibrator


def failed(calibrator):
    """Return the names of the tests of the model that fail."""
    return {each.name for each in calibrator.consistency.statistics() if not each.passed}


def script(name):
    """Return a script of the repository as a module."""
    spec = spec_from_file_location(name, TOP / 'scripts' / f'{name}.py')
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
