# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The motion that is missing: the look ahead against the filter, and the choice."""

from dataclasses import replace

import numpy as np
import pytest

from instruments import PITCH_MM, TAN2018
from starcal_ros.core import camera, rotation
from starcal_ros.core.units import ARCSEC, DEG
from starcal_ros.filter import advice
from starcal_ros.filter.advice import FRAMES, Ahead
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.filter.error_state import Filter
from starcal_ros.filter.states import PHI, STATE_NAMES, THETA
from starcal_ros.filter.verdict import judge
from starcal_ros.measurements.preintegration import Preintegrated, preintegrate
from starcal_ros.measurements.samples import GyroSamples, Stars
from starcal_ros.simulation import sensors

BOTH_ON = {'estimator.augment.gyro_matrix_sigma_ppm': 500.0,
           'estimator.augment.time_offset_sigma_s': 0.01}
INDEX = {name: k for k, name in enumerate(STATE_NAMES)}


def begun(filter_):
    """Return a belief in the middle of a calibration, its values not those of the start."""
    belief = filter_.begin(rotation.exp(np.array([0.3, -1.0, 2.0])))
    root = np.array(belief.root)
    root[THETA] *= 3.0 * ARCSEC / DEG
    augmented = np.where(np.arange(len(belief.nominal.augmented)) < 9, 300e-6, 0.005)
    nominal = replace(belief.nominal, bias=np.array([1e-6, -2e-6, 3e-6]), augmented=augmented,
                      reading=np.array([0.0, 0.3, 0.1]) * DEG)
    return replace(belief, nominal=nominal, root=root)


def rate_of(filter_, nominal, reading):
    """Return the true rate of g that a reading is of."""
    return filter_.augmentation.gain(nominal.augmented) @ (reading - nominal.bias)


@pytest.mark.parametrize('settings', [{}, BOTH_ON], ids=['16 states', '26 states'])
def test_look_ahead_is_the_filter_after_each_motion(settings):
    """Of gyro readings for 60 s; every 10 s a frame of 5 x 5 stars to 0.02 px."""
    filter_ = Filter(TAN2018.replace(settings))
    first, expected, rates = begun(filter_), [], []
    stamps = np.arange(1, 1001) * 10**7
    places = (np.arange(5) + 0.5) / 5.0 * 1024.0 - 512.0     # the middles of fifths of a side
    uv = np.stack(np.meshgrid(places, places), axis=-1).reshape(-1, 2)
    for rate in (np.zeros(3), *(0.5 * DEG * np.eye(3)), np.array([0.1, -0.6, 0.2]) * DEG):
        reading = rate + first.nominal.bias
        rates.append(rate_of(filter_, first.nominal, reading))
        turn = preintegrate(GyroSamples(stamps, np.tile(reading, (1000, 1))),
                            np.array([0, 10**10]), filter_.start.bias, 1e7,
                            filter_.augmentation.needs_matrix)
        belief = first
        for _ in range(6):
            belief = filter_.propagate(belief, Preintegrated(*(part[0] for part in turn)))
            nominal = belief.nominal
            u_i = camera.unproject(uv, nominal.intrinsics, PITCH_MM) @ nominal.C_si
            seen, *_ = filter_.model.predict(nominal, u_i)
            belief = filter_.update(belief, Stars(u_i, seen, np.full(25, 0.02)),
                                    gated=False).belief
        expected.append(np.append(belief.sigma, belief.augmented_sigma))
    np.testing.assert_allclose(advice.sigmas(filter_, first, np.array(rates)), expected,
                               rtol=1e-6)


def test_at_rest_rotations_about_all_axes_both_ways_are_compared():
    tried = advice.motions(np.array([0.0, 0.001, 0.0]) * DEG, 0.02 * DEG)
    assert [motion.text for motion in tried] == [
        FRAMES, *(f'rotate about {axis}' for axis in ('X', 'Y', 'Z', '-X', '-Y', '-Z'))]
    np.testing.assert_allclose([motion.rate / DEG for motion in tried],
                               [np.zeros(3), *0.5 * np.eye(3), *-0.5 * np.eye(3)])


def test_in_motion_it_is_compared_with_rest_reversal_and_other_rates():
    rate = np.array([0.1, 0.2, -0.3]) * DEG
    tried = {motion.text: motion.rate for motion in advice.motions(rate, 0.02 * DEG)}
    for text, factor in ((FRAMES, 1.0), ('stop the rotation', 0.0), ('reverse the rotation', -1.0),
                         ('rotate twice as fast', 2.0), ('rotate half as fast', 0.5)):
        np.testing.assert_allclose(tried[text], factor * rate)
    assert len(tried) == 11 and next(iter(tried)) == FRAMES


def test_present_rate_is_that_of_g():
    filter_ = Filter(TAN2018.replace(BOTH_ON))
    now = begun(filter_).nominal
    matrix = np.eye(3) + now.augmented[:9].reshape(3, 3)
    np.testing.assert_allclose(matrix @ advice.present_rate(now) + now.bias, now.reading,
                               atol=1e-18)


@pytest.mark.parametrize('psi_x, psi_y, text', [
    ((0.5, 0.6, 0.7), (0.5, 0.6, 0.7), 'X'),
    ((0.7, 0.8, 0.6), (0.7, 0.8, 0.6), 'Z'),
    ((0.63, 0.8, 0.6), (0.63, 0.8, 0.6), 'X'),     # within a tenth: the one that is named first
    ((0.2, 0.6, 0.9), (1.2, 0.6, 0.9), 'X'),       # 0.49 on geometric average, 0.6, 0.9
    ((0.95, 0.89, 0.99), (0.95, 0.89, 0.99), 'Y'),
    ((0.95, 0.91, 0.99), (0.95, 0.91, 0.99), FRAMES)], ids=range(6))
def test_best_leaves_least_of_what_going_on_leaves_if_it_is_less_than_0_9(psi_x, psi_y, text):
    """Of the states asked for: that others gain does not count."""
    sigma = 3.0 * np.ones((4, 16))
    sigma[1:, INDEX['psi_x']] *= psi_x
    sigma[1:, INDEX['psi_y']] *= psi_y
    sigma[3, INDEX['f']] = 1e-3
    ahead = Ahead((FRAMES, 'X', 'Y', 'Z'), sigma)
    assert ahead.best([INDEX['psi_x'], INDEX['psi_y']]) == text


# Of the filter, in motion


def calibrated(settings):
    """Return the calibrator after a run."""
    scenario = TAN2018.replace(settings)
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(gyro.next(gyro.count))
    calibrator.add_frames(tracker.next(tracker.count))
    for _ in calibrator.process():
        pass
    return calibrator


ABOUT_Y = {'motion.axes': ('y',), 'motion.angles_deg': (360.0,), 'motion.dwell_s': 5.0,
           'simulation.duration_s': 130.0}


def advised(judged, name):
    """Return the advice on the group that a state is in."""
    said, = [coupling.advice for coupling in judged.couplings if name in coupling.names]
    return said


def test_a_rotation_at_a_constant_rate_is_to_be_reversed():
    """Omega x Psi changes its sign, the bias does not."""
    calibrator = calibrated(ABOUT_Y)
    judged = judge(calibrator.filter, calibrator.belief)
    assert advised(judged, 'epsilon_x') in ('reverse the rotation', 'rotate about -Y')
    assert advised(judged, 'psi_y') in ('rotate about X', 'rotate about Z')


def test_reversal_does_what_is_promised_of_it():
    """The run that goes on and the one that turns back, a minute later."""
    gone_on = calibrated({**ABOUT_Y, 'simulation.duration_s': 192.0})
    back = calibrated({**ABOUT_Y, 'motion.axes': ('y', 'y'), 'motion.dwell_s': 0.0,
                       'motion.angles_deg': (64.0, -64.0), 'simulation.duration_s': 192.0})
    left = back.belief.sigma / gone_on.belief.sigma
    assert (left[[INDEX['epsilon_x'], INDEX['epsilon_z']]] < 0.15).all()
    assert (left[[INDEX['psi_x'], INDEX['psi_z']]] < 0.8).all()


def test_scale_and_bias_are_to_be_told_apart_by_a_change_of_the_rate():
    calibrator = calibrated({**ABOUT_Y, **BOTH_ON})
    judged = judge(calibrator.filter, calibrator.belief)
    assert advised(judged, 'M_yy_ppm') in ('reverse the rotation', 'rotate about -Y')


def test_nothing_is_advised_that_can_not_be_reached():
    """The antisymmetric part of M is a turn of the mounting: the fixed angles stay as they are."""
    calibrator = calibrated({**BOTH_ON, 'simulation.duration_s': 1100.0})
    judged = judge(calibrator.filter, calibrator.belief)
    assert judged.outside == ('psi_x', 'psi_y', 'psi_z') == tuple(judged.never)
    assert judged.motion == ''
    assert {coupling.advice for coupling in judged.couplings} == {'never'}
    assert judged.advice.startswith('never within the tolerance: psi_x, psi_y, psi_z (the antisym')
    # as the look ahead finds, too
    ahead = advice.look_ahead(calibrator.filter, calibrator.belief)
    psi = [INDEX[name] for name in judged.never]
    assert (ahead.sigma[:, psi] > 0.95 * calibrator.belief.sigma[psi]).all()
    assert not np.isnan(ahead.sigma[:, PHI]).any()
