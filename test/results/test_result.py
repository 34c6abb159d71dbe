# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""RESULT.json: what is in it, that its parts agree, that it is JSON."""

import json
import re

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.core import rotation
from starcal_ros.files.output import OutputError
from starcal_ros.filter import verdict
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.progress import Progress
from starcal_ros.filter.states import CALIBRATED, PHI, UNIT
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.results.document import CalibrationError, write_json
from starcal_ros.results.result import result, word
from starcal_ros.simulation import sensors
from starcal_ros.simulation.truth import Truth

SCENARIO = TAN2018.replace({'simulation.duration_s': 90.0})
PROVENANCE = {'version': '1.2.3', 'config_sha256': 'ab', 'bag_sha256': 'cd'}


def calibrated(scenario=SCENARIO, gyro_rows=slice(None)):
    """Return a calibrator that has had all messages of a simulation."""
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(gyro.next(gyro.count)[gyro_rows])
    calibrator.add_frames(tracker.next(tracker.count))
    list(calibrator.process())
    return calibrator


@pytest.fixture(scope='module', params=[True, False], ids=['feedback', 'open loop'])
def calibrator(request):
    """Return a calibrator after its last frame, the gyro 0.37 s further."""
    return calibrated(SCENARIO.replace({'estimator.feedback': request.param}), slice(0, 8987))


@pytest.fixture
def outcome(calibrator):
    """Return its RESULT.json as a dictionary."""
    return result(calibrator, PROVENANCE)


def test_keys_are_those_of_the_interface(outcome):
    """DESIGN Sec. 4; what else was counted may stand in `counts`."""
    intrinsics = {'u0_px', 'v0_px', 'f_mm', 'k1', 'k2', 'p1', 'p2'}
    assert set(outcome) == {
        'intrinsics', 'intrinsics_sigma', 'gyro_bias_deg_h', 'gyro_bias_sigma_deg_h', 'mounting',
        'covariance', 'detector', 'reprojection_rms_px', 'attitude_final', 'verdict', 'converged',
        'consistency', 'variance_factor', 'changes', 'noise_levels', 'tolerance', 'advice',
        'not_told_apart', 'counts', 'provenance'}
    assert set(outcome['intrinsics']) == set(outcome['intrinsics_sigma']) == intrinsics
    assert set(outcome['mounting']) == {'quaternion_xyzw', 'fixed_angles_deg', 'sigma_arcsec'}
    assert set(outcome['attitude_final']) == {'stamp_ns', 'quaternion_xyzw'}
    assert set(outcome['counts']) >= {'gyro', 'frames', 'stars', 'rejected_stars', 'gyro_gaps',
                                      'dropped_messages'}
    assert outcome['provenance'] == PROVENANCE


def test_arrays_have_the_sizes_of_the_interface(outcome):
    assert np.shape(outcome['covariance']) == (16, 16)
    for key, size in (('gyro_bias_deg_h', 3), ('gyro_bias_sigma_deg_h', 3),
                      ('reprojection_rms_px', 2)):
        assert np.shape(outcome[key]) == (size,)
    assert [np.size(outcome['mounting'][key]) for key in (
        'quaternion_xyzw', 'fixed_angles_deg', 'sigma_arcsec')] == [4, 3, 3]
    assert isinstance(outcome['converged'], bool)
    assert isinstance(outcome['attitude_final']['stamp_ns'], int)
    assert all(isinstance(count, int) for count in outcome['counts'].values())


def test_tolerances_have_the_names_and_units_of_the_sigmas(outcome):
    tolerance, of = outcome['tolerance'], SCENARIO.estimator.tolerance
    assert tolerance['gyro_bias_sigma_deg_h'] == pytest.approx([of.gyro_bias_deg_h] * 3)
    assert tolerance['mounting']['sigma_arcsec'] == pytest.approx([of.fixed_angles_arcsec] * 3)
    assert tolerance['intrinsics_sigma'] == pytest.approx({
        'u0_px': of.principal_point_px, 'v0_px': of.principal_point_px, 'f_mm': of.focal_length_mm,
        'k1': of.k1, 'k2': of.k2, 'p1': of.p1, 'p2': of.p2})
    for key, value in tolerance.items():
        assert np.shape(value) == np.shape(outcome[key]) or set(value) <= set(outcome[key])


def test_advice_and_couplings_are_those_of_the_verdict(calibrator, outcome):
    judged = verdict.of(calibrator)
    assert outcome['advice'] == judged.advice != ''
    assert outcome['not_told_apart'] == [
        {'states': list(each.names), 'reason': each.reason, 'advice': each.advice}
        for each in judged.couplings] != []


def test_advice_tells_the_time_where_it_is_known_how_the_run_went(calibrator):
    sigma = calibrator.belief.sigma
    seen = Progress([(0, 1.5 * sigma), (90 * 10**9, 1.2 * sigma), (180 * 10**9, sigma)])
    assert re.search(r'[\d.]+ (s|min|h) more', result(calibrator, PROVENANCE, seen)['advice'])
    assert ' more' not in result(calibrator, PROVENANCE)['advice'].replace('more frames', '')


def test_written_file_is_strict_JSON_with_the_same_values(outcome, tmp_path):
    def refuse(constant):
        raise AssertionError(f'{constant} in a result')

    write_json(tmp_path / 'result.json', outcome)
    text = (tmp_path / 'result.json').read_text()
    assert json.loads(text, parse_constant=refuse) == outcome


@pytest.mark.parametrize('value', [float('nan'), float('inf')])
def test_number_that_is_not_finite_is_never_written(tmp_path, value):
    with pytest.raises(ValueError, match='not JSON compliant'):
        write_json(tmp_path / 'result.json', {'value': value})
    assert not (tmp_path / 'result.json').exists()


def test_file_that_can_not_be_written_is_named_with_the_reason(tmp_path):
    with pytest.raises(OutputError, match=r'nowhere/r\.json: cannot be written: No such'):
        write_json(tmp_path / 'nowhere' / 'r.json', {})


def test_covariance_is_symmetric_and_positive_definite(outcome):
    covariance = np.array(outcome['covariance'])
    sigma = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sigma, sigma)
    np.testing.assert_allclose(correlation, correlation.T, rtol=0, atol=1e-15)
    assert np.linalg.eigvalsh(correlation).min() > 0.0
    np.linalg.cholesky(correlation)


def test_sigmas_are_the_diagonal_of_the_covariance_in_their_units(outcome):
    """rad/s to deg/h and rad to arcsec, both 648000 / pi."""
    sigma = np.sqrt(np.diag(outcome['covariance']))
    np.testing.assert_allclose(outcome['gyro_bias_sigma_deg_h'], sigma[3:6] * 648000 / np.pi,
                               rtol=1e-12)
    np.testing.assert_allclose(outcome['mounting']['sigma_arcsec'], sigma[6:9] * 648000 / np.pi,
                               rtol=1e-12)
    np.testing.assert_allclose(list(outcome['intrinsics_sigma'].values()), sigma[9:], rtol=1e-12)
    assert list(outcome['intrinsics_sigma']) == [
        'u0_px', 'v0_px', 'f_mm', 'k1', 'k2', 'p1', 'p2']


def test_quaternion_and_fixed_angles_describe_the_same_mounting(outcome):
    """C_sg = Rz(z) Ry(y) Rx(x), and the quaternion of the same matrix, DESIGN Sec. 3."""
    x, y, z = np.radians(outcome['mounting']['fixed_angles_deg'])
    C_sg = (np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
            @ np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
            @ np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]))
    quaternion = np.array(outcome['mounting']['quaternion_xyzw'])
    np.testing.assert_allclose(rotation.to_matrix(quaternion), C_sg, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(quaternion), 1.0, rtol=1e-15)


def test_mounting_maps_gyro_components_to_tracker_components(outcome):
    """g to s: the true C_sg of the scenario, to the first 90 s of a calibration."""
    true = rotation.from_fixed_angles(np.radians([-0.1, 30.0, 359.8]))      # T18 Table 1
    error = rotation.log(rotation.to_matrix(np.array(outcome['mounting']['quaternion_xyzw']))
                         @ true.T)
    sigma = np.radians(np.array(outcome['mounting']['sigma_arcsec']) / 3600.0)
    assert (np.abs(error) < 4.0 * sigma).all()
    assert (sigma < np.radians(600.0 / 3600.0)).all()       # less than at first: something learnt


def test_final_attitude_is_integrated_to_the_last_gyro_sample(calibrator, outcome):
    """By hand from the last frame, 89.5 s, to the last of the samples given, 89.87 s."""
    final, start_ns = outcome['attitude_final'], Truth.from_scenario(SCENARIO).motion.start_ns
    assert final['stamp_ns'] == start_ns + 89_870_000_000
    gyro = sensors.gyro(SCENARIO).next(8987)[8950:]
    estimate = calibrator.belief.estimate
    C_gi = estimate.C_gi
    for rate in gyro.rate:
        C_gi = rotation.exp(-(rate - estimate.bias) * 0.01) @ C_gi
    np.testing.assert_allclose(rotation.to_matrix(np.array(final['quaternion_xyzw'])), C_gi.T,
                               rtol=0, atol=1e-13)


def test_final_attitude_is_the_true_orientation_of_the_gyro_in_icrf(outcome):
    final = outcome['attitude_final']
    motion = Truth.from_scenario(SCENARIO).motion
    C_ig = rotation.to_matrix(np.array(final['quaternion_xyzw']))
    error = rotation.log(motion.attitude(np.array([final['stamp_ns']]))[0] @ C_ig.T)
    sigma = np.sqrt(np.diag(outcome['covariance']))[PHI]
    assert (np.abs(error) < 4.0 * sigma).all()


def test_final_attitude_is_that_of_the_last_frame_where_no_sample_is_later():
    calibrator = calibrated(gyro_rows=slice(0, 8950))           # a sample at the frame's own stamp
    final = result(calibrator, PROVENANCE)['attitude_final']
    assert final['stamp_ns'] == calibrator.stamp_ns
    np.testing.assert_allclose(rotation.to_matrix(np.array(final['quaternion_xyzw'])),
                               calibrator.belief.estimate.C_gi.T, rtol=0, atol=1e-15)


def test_calibration_has_converged_when_every_sigma_is_inside_its_tolerance(calibrator, outcome):
    sigma, tolerance = calibrator.belief.sigma[CALIBRATED], calibrator.filter.tolerance
    assert outcome['converged'] == bool((sigma <= tolerance).all()) is False    # after 90 s
    sigma = sigma / UNIT[CALIBRATED]
    wide = {'gyro_bias_deg_h': max(sigma[:3]), 'fixed_angles_arcsec': max(sigma[3:6]),
            'principal_point_px': max(sigma[6:8]), 'focal_length_mm': sigma[8], 'k1': sigma[9],
            'k2': sigma[10], 'p1': sigma[11], 'p2': sigma[12]}
    for factor, expected in ((1.01, True), (0.99, False)):
        scenario = SCENARIO.replace({f'estimator.tolerance.{key}': factor * float(value)
                                     for key, value in wide.items()})
        said = word(calibrated_with(calibrator, scenario))
        assert (said == 'converged') is expected


def calibrated_with(calibrator, scenario):
    """Return a new calibrator of other tolerances that holds the attitude as this one does."""
    other = Calibrator(scenario)
    other.belief, other.consistency = calibrator.belief, calibrator.consistency
    return other


def test_no_frame_no_result_but_the_counts_that_say_why():
    calibrator = Calibrator(SCENARIO)
    gyro = sensors.gyro(SCENARIO).next(500)
    calibrator.add_gyro(gyro)
    calibrator.add_frames(Frames(gyro.stamp_ns[100:200:50], np.zeros(3, np.int64),
                                 np.empty((0, 2)), np.empty(0), np.empty(0),
                                 np.empty(0, np.int64)))
    list(calibrator.process())
    with pytest.raises(CalibrationError, match='500 gyro readings, 2 frames reached by them '
                                               r'\(2 without a usable star'):
        result(calibrator, PROVENANCE)


def test_frames_without_gyro_give_no_result_but_say_that_they_wait():
    calibrator = Calibrator(SCENARIO)
    calibrator.add_gyro(GyroSamples.empty())
    calibrator.add_frames(sensors.star_tracker(SCENARIO).next(10))
    list(calibrator.process())
    with pytest.raises(CalibrationError, match='0 gyro readings.*10 frames waiting for gyro'):
        result(calibrator, PROVENANCE)
