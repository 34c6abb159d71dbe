# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which states can not be told apart: relations of any number of states, and their names."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from instruments import TAN2018
from starcal_ros.filter import ambiguity, verdict
from starcal_ros.filter.calibrator import Calibrator
from starcal_ros.simulation import sensors

BOTH_ON = {'estimator.augment.gyro_matrix_sigma_ppm': 500.0,
           'estimator.augment.time_offset_sigma_s': 0.01}


def pair(rho):
    """Return the correlation of two states."""
    return np.array([[1.0, rho], [rho, 1.0]])


def bound(combinations, noise=1e-4):
    """Return the correlation of states that are some combinations of few, and a little noise."""
    covariance = np.array(combinations) @ np.transpose(combinations)
    covariance = covariance + noise * np.eye(len(covariance))
    width = np.sqrt(np.diag(covariance))
    return covariance / np.outer(width, width)


def about(axis, settings=None, duration_s=130.0):
    """Return the filter and its belief after a rotation about one axis at a constant rate."""
    scenario = TAN2018.replace({
        'motion.axes': (axis,), 'motion.angles_deg': (360.0,), 'motion.dwell_s': 5.0,
        'simulation.duration_s': duration_s, **(settings or {})})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(gyro.next(gyro.count))
    calibrator.add_frames(tracker.next(tracker.count))
    for _ in calibrator.process():
        pass
    return calibrator.filter, calibrator.belief


def found(judged):
    """Return the names of the couplings, each with its reason."""
    return {coupling.names: ambiguity.reason(coupling.names) for coupling in judged.couplings}


# Of any correlation


@pytest.mark.parametrize('rho', [0.0, 0.5, 0.94, 0.949, 0.951, 0.96, 0.9999, 1.0 - 1e-12])
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_of_a_pair_the_criterion_is_the_correlation(rho, sign):
    """Its eigenvalues are 1 - rho and 1 + rho."""
    expected = [[0, 1]] if rho > ambiguity.COUPLED else []
    assert ambiguity.groups(pair(sign * rho)) == expected
    assert ambiguity.groups(block_diag(pair(sign * rho), np.eye(3))) == expected


def test_a_sum_is_found_of_which_no_pair_is_correlated():
    """x3 = x1 + x2, and of four states two angles of 30 degrees: the pairs have 0.87 at most."""
    three = bound([(1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
    assert np.abs(three[~np.eye(3, dtype=bool)]).max() < 0.71
    assert ambiguity.groups(three) == [[0, 1, 2]]
    c, s = np.cos(np.pi / 6.0), 0.5
    four = bound([(1.0, 0.0), (0.0, 1.0), (c, s), (-s, c)])
    assert np.abs(four[~np.eye(4, dtype=bool)]).max() < 0.87
    assert ambiguity.groups(four) == [[0, 1, 2, 3]]


def test_relations_of_the_same_strength_are_not_mixed():
    """Their eigenvectors are: any rotation of them is as good."""
    strong = pair(1.0 - 1e-9)
    assert ambiguity.groups(block_diag(strong, strong, np.eye(2), strong)) == [
        [0, 1], [2, 3], [6, 7]]


def test_independent_states_are_not_bound_however_many():
    assert ambiguity.groups(np.eye(26)) == []
    # weak correlations all over have a large eigenvalue, and no relation
    assert ambiguity.groups(0.5 * np.eye(26) + 0.5) == []


@pytest.mark.parametrize('states, part', [
    (('u0', 'psi_y'), 'in the middle of the field'),
    (('attitude_x', 'psi_x'), 'only their sum'),
    (('attitude_x', 'epsilon_x', 'psi_z'), 'a turn of the mounting looks like a bias'),
    (('epsilon_y', 'M_yy_ppm'), 'the gyro matrix looks like a bias'),
    (('epsilon_y', 'tau_s'), 'a time offset turns the stars as the gyro error does'),
    (('M_yy_ppm', 'tau_s'), 'a time offset turns the stars as the gyro error does'),
    (('attitude_y', 'tau_s'), 'a time offset is a turn of the camera'),
    (('psi_x', 'M_zy_ppm'), 'about one axis'),
    (('psi_x', 'M_yz_ppm', 'M_zy_ppm'), 'antisymmetric'),
    (('k1', 'k2'), 'almost alike')])
def test_combination_is_named_in_words(states, part):
    assert part in ambiguity.reason(states)


# Of the filter


def test_at_a_constant_rate_bias_and_mounting_are_one_effect():
    """Omega x Psi, omega about y: of bias and mounting the components across y."""
    filter_, belief = about('y')
    group, = [names for names in found(verdict.judge(filter_, belief)) if 'epsilon_x' in names]
    assert {'epsilon_x', 'epsilon_z', 'psi_x', 'psi_z'} <= set(group)
    assert not {'epsilon_y', 'psi_y'} & set(group)
    assert 'at a constant rate a turn of the mounting looks like a bias' in ambiguity.reason(group)
    # pairs do not show it
    C = ambiguity.correlation(belief)
    at = [ambiguity.NAMES.index(name) for name in ('epsilon_x', 'epsilon_z', 'psi_x', 'psi_z')]
    assert np.abs(C[np.ix_(at, at)] - np.eye(4)).max() < ambiguity.COUPLED


def test_augmented_states_are_looked_at_too():
    filter_, belief = about('y', BOTH_ON)
    judged = verdict.judge(filter_, belief)
    assert judged.names[16:] == filter_.augmentation.names
    assert judged.correlation.shape == (26, 26)
    said = found(judged)
    assert 'gyro matrix looks like a bias' in said['epsilon_y', 'M_yy_ppm']
    assert any('M_zy_ppm' in names and 'psi_x' in names for names in said)


def test_the_antisymmetric_part_of_the_gyro_matrix_stays_with_the_mounting():
    scenario = TAN2018.replace({**BOTH_ON, 'simulation.duration_s': 600.0})
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    calibrator = Calibrator(scenario)
    calibrator.add_gyro(gyro.next(gyro.count))
    calibrator.add_frames(tracker.next(tracker.count))
    for _ in calibrator.process():
        pass
    judged = verdict.judge(calibrator.filter, calibrator.belief)
    bound_to_M = [set(names) for names in found(judged) if 'M_xz_ppm' in names]
    assert bound_to_M == [{'attitude_y', 'psi_y', 'M_xz_ppm', 'M_zx_ppm'}]
    assert 'antisymmetric' in ambiguity.reason(bound_to_M[0])
