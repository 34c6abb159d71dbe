# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Comparisons: chi-squares that have their distribution, turns that are none, trends."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from instruments import DETECTOR, INTRINSICS, TAN2018
from starcal_ros.core import camera, rotation
from starcal_ros.core.units import ARCSEC
from starcal_ros.filter.offline import calibrate
from starcal_ros.filter.states import UNIT
from starcal_ros.results import comparison
from starcal_ros.results.read import StoredResult, read_result
from starcal_ros.results.document import CalibrationError, dumps
from starcal_ros.results.result import result
from starcal_ros.simulation import sensors

DAY_NS = 86_400 * 10**9


@pytest.fixture(scope='module')
def path(tmp_path_factory):
    """Return the RESULT.json of half a minute."""
    scenario = TAN2018.replace({'simulation.duration_s': 60.0})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator, _ = calibrate(gyro.next(gyro.count), tracker.next(tracker.count), scenario)
    file = tmp_path_factory.mktemp('result') / 'result.json'
    file.write_text(dumps(result(calibrator, {'bag_sha256': 'abc', 'began_with': ''})))
    return file


@pytest.fixture(scope='module')
def stored(path):
    return read_result(path)


def off(stored, error, name='other', stamp_ns=None):
    """Return a result that is off by an error of its 13 states."""
    return dataclasses.replace(
        stored, name=name, bias=stored.bias + error[:3],
        C_sg=rotation.exp(error[3:6]) @ stored.C_sg, intrinsics=stored.intrinsics + error[6:],
        stamp_ns=stamp_ns or stored.stamp_ns)


def draws(stored, count, seed=1):
    """Return results of other data of the same instrument."""
    scale = np.sqrt(np.diagonal(stored.covariance))
    root = np.linalg.cholesky(stored.covariance / np.outer(scale, scale)) * scale[:, None]
    return [off(stored, root @ each) for each in
            np.random.default_rng(seed).standard_normal((count, 13))]


def test_what_was_written_is_read(stored, path):
    found = json.loads(path.read_text())
    assert stored.intrinsics[2] == found['intrinsics']['f_mm']
    np.testing.assert_allclose(stored.bias / UNIT[3:6], found['gyro_bias_deg_h'], rtol=1e-12)
    assert stored.covariance.shape == (13, 13) and stored.detector == DETECTOR
    assert (stored.verdict, stored.bag_sha256) == ('not yet', 'abc')


@pytest.mark.parametrize('text, said', [
    ('', 'not JSON'), ('[]', 'no intrinsics'), ('{"parameters": {}}', 'still images'),
    ('{"intrinsics": {}, "covariance": [[1]]}', '16 x 16 or 7 x 7'),
    ('{"intrinsics": {}, "covariance": 3}', '16 x 16')])
def test_what_is_no_result_is_refused(tmp_path, text, said):
    file = tmp_path / 'x.json'
    file.write_text(text)
    with pytest.raises(CalibrationError, match=f'{file}: is no result of a calibration: .*{said}'):
        read_result(file)
    with pytest.raises(CalibrationError, match='cannot be read'):
        read_result(tmp_path / 'none.json')


def test_the_chi_square_of_two_is_that_of_their_difference(stored):
    a, b = draws(stored, 2)
    found = comparison.agreements([a, b])
    rows = comparison.states(a, b)
    d = np.array([row.difference for row in rows]) * UNIT[3:]
    for name, group in comparison.GROUPS.items():
        C = 2.0 * stored.covariance[group, group]
        scale = np.sqrt(np.diagonal(C))
        direct = (d[group] / scale) @ np.linalg.solve(C / np.outer(scale, scale), d[group] / scale)
        assert found[name].chi2 == pytest.approx(direct, rel=1e-5)
        assert found[name].freedom == len(d[group])
    sigma = np.sqrt(2.0 * np.diagonal(stored.covariance)) / UNIT[3:]
    np.testing.assert_allclose([row.sigma for row in rows], sigma, rtol=1e-12)


@pytest.mark.parametrize('count', [2, 4])
def test_chance_is_what_is_stated_where_the_instrument_is_the_same(stored, count):
    results = draws(stored, 400 * count, seed=count)
    found = [comparison.agreements(results[k::400]) for k in range(400)]
    for name in comparison.GROUPS:
        assert kstest([each[name].probability for each in found], 'uniform').pvalue > 1e-3
    assert sum(bool(comparison.differing(each)) for each in found) <= 3    # of 0.4 expected


def test_a_camera_that_has_changed_differs_and_a_bias_may_wander(stored):
    sigma = np.sqrt(np.diagonal(stored.covariance))
    for state, named in ((8, True), (5, True), (0, False)):
        error = np.zeros(13)
        error[state] = 12.0 * sigma[state]
        found = comparison.agreements([stored, off(stored, error)])
        assert bool(comparison.differing(found)) is named
    assert found['gyro bias'].probability < 1e-10


def test_the_same_lens_on_another_mounting_differs_in_the_gyro_axes_alone(stored):
    error = np.zeros(13)
    error[3:6] = np.array([10.0, -20.0, 5.0]) * ARCSEC
    found = comparison.over_detector(stored, off(stored, error), DETECTOR)
    assert found.length.max() < 1e-9 and np.linalg.norm(found.turn) < 1e-12
    np.testing.assert_allclose(found.net, -stored.C_sg.T @ error[3:6], rtol=1e-4)


def test_a_turn_is_taken_out_and_a_mounting_makes_up_for_it(stored):
    """A principal point that is off by 0.1 px is a turn of 5 arcsec, and next to nothing else."""
    error = np.zeros(13)
    error[6] = 0.1
    found = comparison.over_detector(stored, off(stored, error), DETECTOR)
    angle = 0.1 * DETECTOR.pitch_mm / INTRINSICS[2]
    assert np.linalg.norm(found.turn) == pytest.approx(angle, rel=0.02)
    assert found.length.max() < 0.01
    error[3:6] = found.turn
    found = comparison.over_detector(stored, off(stored, error), DETECTOR)
    assert np.linalg.norm(found.net) < 1e-3 * angle


def test_what_is_left_is_what_pixels_see_after_the_turn(stored):
    """And no small turn makes it less."""
    error = np.array([0.0] * 6 + [1.0, -2.0, 0.01, 1e-5, 1e-8, 2e-6, 0.0])
    other = off(stored, error)
    found = comparison.over_detector(stored, other, DETECTOR)
    r_a = camera.unproject(found.uv.reshape(-1, 2), stored.intrinsics, DETECTOR.pitch_mm)

    def left(turn):
        return camera.project(r_a @ rotation.exp(turn).T, other.intrinsics,
                              DETECTOR.pitch_mm) - found.uv.reshape(-1, 2)
    np.testing.assert_allclose(left(found.turn), found.difference.reshape(-1, 2), atol=1e-9)
    least = np.sum(left(found.turn)**2)
    for step in 1e-6 * np.vstack((np.eye(3), -np.eye(3))):
        assert np.sum(left(found.turn + step)**2) > least


def test_sigmas_over_the_detector_and_of_the_turn_are_those_of_draws(stored):
    """Root mean squares of 300 pairs, to four of their standard errors."""
    results = draws(stored, 600, seed=9)
    found = [comparison.over_detector(a, b, DETECTOR)
             for a, b in zip(results[::2], results[1::2])]
    rms = np.sqrt(np.mean([each.difference**2 for each in found], axis=(0, -1)))
    np.testing.assert_allclose(rms, found[0].sigma, rtol=4.0 / np.sqrt(2.0 * 300))
    net = np.sqrt(np.mean([each.net**2 for each in found], axis=0))
    np.testing.assert_allclose(net, found[0].net_sigma, rtol=4.0 / np.sqrt(2.0 * 300))


def test_a_trend_is_found_and_a_state_that_stays_has_none(stored):
    sigma = np.sqrt(np.diagonal(stored.covariance))
    results = []
    for k, each in enumerate(draws(stored, 12, seed=4)):
        moved = np.zeros(13)
        moved[8] = 3.0 * k * sigma[8]           # the focal length, a day
        results.append(off(each, moved, stamp_ns=stored.stamp_ns + k * DAY_NS))
    trends = {each.name: each for each in comparison.trends(results)}
    assert set(trends) == set(comparison.NAMES)
    f = trends['f']
    assert abs(f.slope - 3.0 * sigma[8]) < 4.0 * f.sigma and f.constant.probability < 1e-10
    assert f.line.probability > 1e-3 and f.line.freedom == 10
    assert all(each.constant.probability > 1e-4 for name, each in trends.items() if name != 'f')
    assert comparison.trends(results[:2]) == []


def test_a_camera_alone_is_compared_with_the_camera_of_another(stored):
    alone = StoredResult('camera', stored.intrinsics + 1e-9, stored.of_camera, None, None, None,
                         None, '', '', '')
    found = comparison.agreements([stored, alone])
    assert list(found) == ['camera'] and found['camera'].freedom == 7
    assert comparison.over_detector(stored, alone, DETECTOR).net is None
    held = np.array(alone.covariance)
    held[6] = held[:, 6] = 0.0
    held = dataclasses.replace(alone, covariance=held)
    assert comparison.agreements([held, alone])['camera'].freedom == 6
    assert found['camera'].probability == pytest.approx(chi2.sf(found['camera'].chi2, 7))
