# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where a saved calibration ended, another begins; and what can not be used is passed over."""

import json

import numpy as np
import pytest

from instruments import TAN2018
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.error_state import SIGMA_ACQUIRED, Filter
from starcal_ros.filter.states import CALIBRATED, EPSILON, LENS, PSI
from starcal_ros.results import initial, result
from starcal_ros.results.store import CalibrationStore
from starcal_ros.simulation import sensors

SCENARIO = TAN2018.replace({'simulation.duration_s': 120.0})
ASKED = SCENARIO.replace({'estimator.load_calibration': True})


def fed(calibrator, gyro, frames):
    """Return a calibrator after messages."""
    calibrator.add_gyro(gyro)
    calibrator.add_frames(frames)
    for _ in calibrator.process():
        pass
    return calibrator


@pytest.fixture(scope='module')
def messages():
    gyro, tracker = sensors.gyro(SCENARIO), sensors.star_tracker(SCENARIO)
    return gyro.next(gyro.count), tracker.next(tracker.count)


@pytest.fixture(scope='module')
def half(messages):
    """A calibration from the first minute."""
    gyro, frames = messages
    return fed(Calibrator(SCENARIO), gyro[:6001], frames[:121])


@pytest.fixture
def archive(tmp_path, half):
    """Return an archive with that calibration."""
    archive = CalibrationStore(tmp_path)
    archive.save(initial.files(result.result(half, {'version': '1'}), SCENARIO))
    return archive


def test_values_and_covariance_are_those_that_were_saved(archive, half):
    begun = initial.initial_values(ASKED, archive)
    filter_, estimate = Filter(begun.scenario, begun.covariance), half.belief.estimate
    np.testing.assert_allclose(filter_.start.intrinsics, estimate.intrinsics, rtol=1e-12)
    np.testing.assert_allclose(filter_.start.bias, estimate.bias, rtol=1e-12)
    np.testing.assert_allclose(filter_.start.C_sg, estimate.C_sg, atol=1e-14)
    belief = filter_.begin(np.eye(3))
    saved = half.belief.covariance[CALIBRATED, CALIBRATED]
    sigma = np.sqrt(np.diagonal(saved))
    np.testing.assert_allclose(belief.covariance[CALIBRATED, CALIBRATED] / np.outer(sigma, sigma),
                               saved / np.outer(sigma, sigma), atol=1e-9)
    np.testing.assert_allclose(belief.tracker_sigma, SIGMA_ACQUIRED)
    assert begun.source == str(archive.directory / '0001')
    assert any('0001' in text for text in begun.notices)


def test_a_calibration_in_two_parts_is_as_good_as_in_one(archive, messages):
    """The attitude is lost between the parts and found again, which tells little of the rest."""
    gyro, frames = messages
    begun = initial.initial_values(ASKED, archive)
    second = fed(Calibrator(begun.scenario, begun.covariance), gyro[6001:], frames[121:])
    whole = fed(Calibrator(SCENARIO), gyro, frames)
    ratio = second.belief.sigma[CALIBRATED] / whole.belief.sigma[CALIBRATED]
    # The frames on both sides of the cut are not tied. A slope, such as the bias, is then known up
    # to twice less well: each half has an eighth of its information. Of 240 ties one is lost.
    assert (ratio > 1.0 - 1e-6).all() and (ratio[:3] < 2.0).all() and (ratio[3:] < 1.1).all()
    error = second.belief.estimate.minus(whole.belief.estimate)[CALIBRATED]
    assert (np.abs(error) < 3.0 * second.belief.sigma[CALIBRATED]).all()
    # from the second minute alone much less
    alone = fed(Calibrator(SCENARIO), gyro[6001:], frames[121:])
    assert (alone.belief.sigma[LENS] > 1.2 * second.belief.sigma[LENS]).all()


def test_nothing_is_loaded_unless_asked_for(archive):
    assert initial.initial_values(SCENARIO, archive) == initial.InitialValues(SCENARIO)


def test_without_a_saved_one_the_nominal_values_are_used_and_that_is_said(tmp_path):
    begun = initial.initial_values(ASKED, CalibrationStore(tmp_path / 'none'))
    assert begun.scenario == ASKED and begun.covariance is None and begun.source == ''
    assert 'has no calibration' in begun.notices[0]


def test_undone_calibration_is_not_loaded(archive):
    archive.undo()
    assert initial.initial_values(ASKED, archive).source == ''


def spoil(folder, how):
    """Make a saved calibration unusable."""
    path = folder / 'result.json'
    values = json.loads(path.read_text())
    if how == 'cut short':
        path.write_text(path.read_text()[:1000])
    elif how == 'missing':
        path.unlink()
    elif how == 'other detector':
        config = folder / 'config.yaml'
        config.write_text(config.read_text().replace('width: 1024', 'width: 2048'))
    else:
        if how == 'no bias':
            del values['gyro_bias_deg_h']
        elif how == 'NaN':
            values['covariance'][4][4] = float('nan')
        elif how == 'impossible':
            values['intrinsics']['f_mm'] = -1.0
        elif how == '400 digits':
            values['covariance'][4][4] = 10**400
        elif how == 'not symmetric':
            values['covariance'][4][5] += 0.01 * values['covariance'][4][4]
        elif how == 'indefinite':
            a, b = values['covariance'][4][4], values['covariance'][7][7]
            values['covariance'][4][7] = values['covariance'][7][4] = 1.5 * (a * b)**0.5
        path.write_text(json.dumps(values))


@pytest.mark.parametrize('how, said', [
    ('cut short', 'is no calibration'), ('missing', 'cannot be read'), ('no bias', 'gyro_bias'),
    ('NaN', 'covariance'), ('impossible', 'camera.focal_length_mm: got -1.0'),
    ('400 digits', 'is no calibration: '), ('not symmetric', 'is not symmetric and positive'),
    ('indefinite', 'is not symmetric and positive definite'),
    ('other detector', '2048 x 1024 pixels')])
def test_calibration_that_can_not_be_used_is_passed_over_for_the_one_before(
        archive, half, how, said):
    newer = archive.save(initial.files(result.result(half, {'version': '1'}), SCENARIO))
    spoil(newer, how)
    begun = initial.initial_values(ASKED, archive)
    assert begun.source == str(archive.directory / '0001')
    assert '0002' in begun.notices[0] and said in begun.notices[0]


def test_other_gates_and_noise_are_used_from_then_on(messages):
    gyro, frames = messages
    calibrator = fed(Calibrator(SCENARIO), gyro[:3000], frames[:60])
    before = calibrator.belief
    options = SCENARIO.replace({
        'estimator.gate_probability': 0.5,
        'estimator.process_noise.gyro_bias_deg_h_sqrt_h': 10.0}).estimator
    calibrator.use(options)
    assert calibrator.belief is before
    rejected = calibrator.counts.rejected_stars
    fed(calibrator, gyro[3000:6000], frames[60:120])
    assert calibrator.counts.rejected_stars - rejected > 0.4 * frames.star_counts[60:120].sum()
    assert (calibrator.belief.sigma[EPSILON] > before.sigma[EPSILON]).all()
    assert calibrator.belief.sigma[PSI].max() < 1.0
