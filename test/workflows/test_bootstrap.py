# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The chain from a focal length that is a tenth wrong and unidentified stars to the 16 states."""

import json

import numpy as np
import pytest
from scipy.stats import chi2

from instruments import TAN2018
from starcal_ros.cli import main
from starcal_ros.config import parameter_file
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.results.document import CalibrationError
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth
from starcal_ros.simulation.write_recording import simulate
from starcal_ros.workflows.bootstrap import bootstrap

pytest.importorskip('tetra3rs')

SCENARIO = TAN2018.replace({'simulation.duration_s': 480.0, 'camera.focal_length_mm': 23.5})
TRUTH = Truth.from_scenario(SCENARIO)
LIMIT = chi2.ppf(0.9999, 7)


@pytest.fixture(scope='module')
def sensed():
    """Return the readings and frames of eight minutes."""
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    return gyro.next(gyro.count), tracker.next(tracker.count)


@pytest.fixture(scope='module')
def chain(sensed):
    """Return what came of them."""
    return bootstrap(*sensed, SCENARIO)


def test_each_step_says_the_truth_and_more_than_the_last(chain):
    names = [step.name for step in chain.steps]
    assert names == ['nominal', 'self-calibration', 'bundle of the spots', 'angular distances',
                     '16 states']
    for step in chain.steps[1:]:
        error = step.camera.intrinsics - TRUTH.intrinsics
        assert error @ np.linalg.solve(step.camera.covariance, error) < LIMIT, step.name
    sigma = [step.camera.sigma[2] for step in chain.steps]
    assert sigma[1] < sigma[0] and sigma[2] < 0.02 * sigma[0]
    assert sigma[3] < 0.02 * sigma[2] and sigma[4] < sigma[3]


def test_the_stars_are_identified_and_none_wrongly(chain, sensed):
    _, frames = sensed
    true = frames[len(frames) // 4:].catalog_id
    found = chain.frames.catalog_id
    assert (found[found > 0] == true[found > 0]).all()
    assert (found > 0).mean() > 0.98


def test_filter_sees_only_frames_that_nothing_else_has_learnt_from(chain, sensed):
    n = len(sensed[1])
    assert chain.calibrator.counts.frames == n - n // 2
    assert chain.steps[3].camera.frames <= n // 2 - n // 4


def test_too_little_is_named(sensed):
    gyro, frames = sensed
    with pytest.raises(CalibrationError, match='self-calibration: no camera from 2 frames'):
        bootstrap(gyro, frames[:8], SCENARIO)
    with pytest.raises(CalibrationError, match='no camera from 0 frames'):
        bootstrap(GyroSamples.empty(), Frames.empty(), SCENARIO)


@pytest.mark.slow
def test_command_shows_the_camera_after_each_step(tmp_path, capsys):
    bag, out, config = tmp_path / 'run.mcap', tmp_path / 'result.json', tmp_path / 'off.yaml'
    simulate(SCENARIO.replace({'simulation.duration_s': 360.0}), bag)
    config.write_text(parameter_file.dump(SCENARIO))
    assert main(['bootstrap', str(bag), '--config', str(config), '--out', str(out)]) == 3
    result = json.loads(out.read_text())
    assert [step['step'] for step in result['steps']][-1] == '16 states'
    assert abs(result['intrinsics']['f_mm'] - TRUTH.intrinsics[2]) < 1e-3
    said = capsys.readouterr().out
    assert 'error ± sigma after each step' in said and 'spots identified' in said
