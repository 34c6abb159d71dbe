# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal intrinsics`` on recordings: with gyro and without, its result and its errors."""

import json

import numpy as np
import pytest
import yaml

from instruments import CONFIG, TAN2018
from starcal_ros.calibration.methods import predicted_centroid
from starcal_ros.cli import main
from starcal_ros.config import parameter_file
from starcal_ros.config.models import nominal_camera
from starcal_ros.core.camera import INTRINSICS, INTRINSICS_KEYS
from starcal_ros.core.camera_estimate import CameraEstimate
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import LENS, SCALE
from starcal_ros.recording import reader
from starcal_ros.recording.reader import RecordError
from starcal_ros.recording.writer import Writer, centroids_batch
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

SCENARIO = TAN2018.replace({'simulation.duration_s': 150.0})
TRUE = Truth.from_scenario(SCENARIO).intrinsics


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return a recording of the star tracker alone: one slew."""
    path = tmp_path_factory.mktemp('bag') / 'stars.mcap'
    tracker = sensors.star_tracker(SCENARIO)
    with Writer(path) as writer:
        writer.write_batches(centroids_batch('/star_tracker/centroids',
                                             tracker.next(tracker.count)))
    return path


def test_recording_without_gyro_gives_the_camera(bag, tmp_path, capsys):
    out = tmp_path / 'camera.json'
    export = tmp_path / 'export'
    assert main(['intrinsics', str(bag), '--config', str(CONFIG), '--method', 'bundle', '--out',
                 str(out), '--export', str(export)]) == 3
    result = json.loads(out.read_text())
    info = yaml.safe_load((export / 'camera_info.yaml').read_text())
    pitch_mm = SCENARIO.camera.pixel_pitch_mm
    assert info['camera_matrix']['data'][0] * pitch_mm == pytest.approx(
        result['intrinsics']['f_mm'])
    assert sorted(path.name for path in export.iterdir()) == [
        'camchain.yaml', 'camera_info.yaml', 'cameras.txt', 'opencv.yaml']
    error = np.array([result['intrinsics'][key] for key in INTRINSICS_KEYS]) - TRUE
    assert error @ np.linalg.solve(result['covariance'], error) < 24.3  # 0.999 of chi-square, 7
    assert result['counts']['frames'] == 300 and result['method'] == 'bundle'
    assert list(result['intrinsics_sigma']) == list(INTRINSICS_KEYS)
    assert len(result['provenance']['bag_sha256']) == 64
    assert result['verdict'] == 'not yet' and not result['converged']
    assert result['consistency'] and all(each['passed'] for each in result['consistency'])
    assert result['tolerance']['u0_px'] == 0.1 and 'u0_px' in result['advice']
    assert result['variance_factor']['centroids'] == pytest.approx(1.0, abs=0.1)
    said = capsys.readouterr().out
    assert 'bundle' in said and 'Verdict: not yet' in said and 'scaled' not in said


def test_what_is_not_estimated_is_held_and_contradicted_where_it_is_wrong(bag, tmp_path, capsys):
    out = tmp_path / 'camera.json'
    assert main(['intrinsics', str(bag), '--config', str(CONFIG), '--method', 'bundle', '--out',
                 str(out), '--estimate', 'f', 'k1']) == 4
    result = json.loads(out.read_text())
    sigma = result['intrinsics_sigma']
    assert [key for key, value in sigma.items() if value > 0.0] == ['f_mm', 'k1']
    said = capsys.readouterr().out
    assert 'held' in said and 'not to be believed' in said and 'sigma, scaled' in said
    assert result['verdict'] == 'inconsistent' and result['variance_factor']['f_mm'] > 1.0


def test_a_camera_inside_its_tolerances_is_consistent(bag, tmp_path):
    config = tmp_path / 'config.yaml'
    config.write_text(parameter_file.dump(SCENARIO.replace({
        'estimator.tolerance.principal_point_px': 1.0, 'estimator.tolerance.focal_length_mm': 1e-3,
        'estimator.tolerance.k1': 1e-5, 'estimator.tolerance.p1': 1e-5,
        'estimator.tolerance.p2': 1e-5})))
    assert main(['intrinsics', str(bag), '--config', str(config), '--method', 'bundle']) == 0


def test_a_method_that_needs_the_gyro_says_so(bag, capsys):
    assert main(['intrinsics', str(bag), '--config', str(CONFIG), '--method',
                 'predicted_centroid']) == 1
    assert 'no camera from 300 frames' in capsys.readouterr().err


def test_calibrate_refuses_a_recording_without_gyro(bag):
    with pytest.raises(RecordError, match='no topic /imu/data_raw'):
        reader.read(bag)
    assert not len(reader.read(bag, needs_gyro=False).gyro)


@pytest.mark.parametrize('words, culprit', [
    (['--estimate', 'f', 'k3'], "intrinsics.estimate: got 'k3'"),
    (['--singular-values', '4'], 'intrinsics.singular_values: got 4'),
    (['--combination-model', '5'], 'intrinsics.combination_model: got 5'),
    (['--method', 'guess'], "got 'guess', allowed are"),
    (['--report', 'x.html'], '--report: is for still images'),
    (['--site', '40,3'], 'parameter file of a recording has observer.site_deg'),
    (['--pixel-phase'], 'with estimator.augment.pixel_phase_sigma_px'),
])
def test_wrong_options_are_named(words, culprit, bag, capsys):
    config = [] if '--report' in words else ['--config', str(CONFIG)]
    assert main(['intrinsics', str(bag), *config, *words]) == 2
    assert culprit in capsys.readouterr().err


def test_methods_begin_where_the_configuration_says():
    scenario = SCENARIO.replace({'intrinsics.estimate': ('f', 'k1')})
    begun = nominal_camera(scenario)
    np.testing.assert_array_equal(np.array(INTRINSICS)[begun.sigma > 0.0], ['f', 'k1'])
    assert begun.sigma[2] == pytest.approx(scenario.estimator.initial_sigma.focal_length_mm)
    assert begun.intrinsics[2] == scenario.camera.focal_length_mm
    np.testing.assert_allclose(nominal_camera(SCENARIO).sigma,
                               Filter(SCENARIO).initial_sigma[LENS])


def test_filter_begins_with_what_is_known_of_the_camera():
    rng = np.random.default_rng(1)
    root = SCALE[LENS, None] * rng.standard_normal((7, 7))
    known = CameraEstimate(TRUE, root @ root.T, 10, 100)
    filter_ = predicted_centroid.begin(SCENARIO, known).filter
    belief = filter_.begin(np.eye(3))
    np.testing.assert_array_equal(belief.nominal.intrinsics, TRUE)
    scale = np.outer(known.sigma, known.sigma)
    np.testing.assert_allclose(belief.covariance[LENS, LENS] / scale, known.covariance / scale,
                               atol=1e-9)
    np.testing.assert_allclose(belief.sigma[3:9], Filter(SCENARIO).initial_sigma[3:9])
