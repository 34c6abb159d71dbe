# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""SO(3): against scipy's Rotation, exact cases, and identities down to the rounding."""

import numpy as np
import pytest
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from starcal_ros.core import rotation

# An element of a matrix or a quaternion is a sum of a few products of numbers below 1, each
# rounded by 1.1e-16.
ROUNDING = 2e-15

RNG = np.random.default_rng(1)
AXES = np.concatenate((np.eye(3), -np.eye(3), RNG.normal(size=(20, 3))))
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
ANGLES = {'zero': 0.0, 'tiny': 1e-12, 'small': 1e-5, 'middle': 1.0, 'wide': 2.5,
          'near pi': np.pi - 1e-9}


@pytest.fixture(params=list(ANGLES.values()), ids=list(ANGLES))
def phi(request):
    return AXES * request.param


@pytest.fixture
def quaternions():
    q = np.random.default_rng(2).normal(size=(50, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def test_skew_is_the_cross_product():
    v, w = np.random.default_rng(3).normal(size=(2, 30, 3))
    np.testing.assert_allclose((rotation.skew(v) @ w[..., None])[..., 0], np.cross(v, w),
                               atol=ROUNDING * 10)          # numbers up to 3, products up to 10


def test_exp_of_a_quarter_turn_about_z_takes_x_to_y():
    C = rotation.exp(np.array([0.0, 0.0, np.pi / 2]))
    np.testing.assert_allclose(C @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=ROUNDING)


def test_exp_is_scipys(phi):
    np.testing.assert_allclose(rotation.exp(phi), Rotation.from_rotvec(phi).as_matrix(),
                               atol=ROUNDING)


def test_exp_of_a_tiny_vector_keeps_its_relative_precision():
    phi = 1e-12 * AXES
    np.testing.assert_allclose(rotation.exp(phi) - np.eye(3), rotation.skew(phi),
                               rtol=1e-15, atol=1e-23)      # phi^2 / 2 = 5e-25


def test_exp_quaternion_is_scipys(phi):
    np.testing.assert_allclose(rotation.exp_quaternion(phi), Rotation.from_rotvec(phi).as_quat(),
                               atol=ROUNDING)


def test_log_inverts_exp(phi):
    # An angle is twice that of the quaternion, whose components are good to the rounding.
    np.testing.assert_allclose(rotation.log(rotation.exp(phi)), phi,
                               rtol=1e-14, atol=2 * ROUNDING * np.abs(phi).max())


def test_log_is_scipys(quaternions):
    reference = Rotation.from_quat(quaternions)
    np.testing.assert_allclose(rotation.log(reference.as_matrix()), reference.as_rotvec(),
                               atol=2 * ROUNDING)


@pytest.mark.parametrize('axis', range(3))
def test_log_of_half_a_turn_has_length_pi(axis):
    C = -np.eye(3)
    C[axis, axis] = 1.0
    np.testing.assert_array_equal(np.abs(rotation.log(C)), np.pi * np.eye(3)[axis])


def test_quaternion_of_a_matrix_is_scipys(phi):
    q = rotation.to_quaternion(Rotation.from_rotvec(phi).as_matrix())
    expected = Rotation.from_rotvec(phi).as_quat()
    sign = np.sign(np.sum(q * expected, axis=-1, keepdims=True))
    np.testing.assert_allclose(sign * q, expected, atol=ROUNDING)


def test_matrix_of_a_quaternion_is_scipys(quaternions):
    np.testing.assert_allclose(rotation.to_matrix(quaternions),
                               Rotation.from_quat(quaternions).as_matrix(), atol=ROUNDING)


def test_quaternion_and_its_negative_are_one_rotation(quaternions):
    np.testing.assert_array_equal(rotation.to_matrix(quaternions),
                                  rotation.to_matrix(-quaternions))


def test_rotations_compose_from_right_to_left():
    """A turn by x, then by z about the fixed axes, is Rz Rx."""
    x, z = np.array([np.pi / 2, 0.0, 0.0]), np.array([0.0, 0.0, np.pi / 2])
    moved = rotation.exp(z) @ rotation.exp(x) @ [0.0, 1.0, 0.0]         # y to z, and z stays
    np.testing.assert_allclose(moved, [0.0, 0.0, 1.0], atol=ROUNDING)


def test_fixed_angles_turn_about_fixed_x_then_y_then_z():
    angles = np.random.default_rng(4).uniform(-np.pi, np.pi, (50, 3))
    np.testing.assert_allclose(rotation.from_fixed_angles(angles),
                               Rotation.from_euler('xyz', angles).as_matrix(), atol=ROUNDING)


def test_fixed_angles_come_back_inside_their_range():
    angles = np.random.default_rng(5).uniform(-1.0, 1.0, (50, 3)) * [3.1, 1.4, 3.1]
    # arctan2 of numbers of size cos(1.4) = 0.17, each good to the rounding
    np.testing.assert_allclose(rotation.to_fixed_angles(rotation.from_fixed_angles(angles)),
                               angles, atol=ROUNDING / 0.17)


@pytest.mark.parametrize('y', [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9])
def test_fixed_angles_give_their_matrix_back_where_x_and_z_can_not_be_told_apart(y):
    xz = np.random.default_rng(6).uniform(-3.0, 3.0, (20, 2))
    C_sg = Rotation.from_euler('xyz', np.insert(xz, 1, y, axis=1)).as_matrix()
    np.testing.assert_allclose(rotation.from_fixed_angles(rotation.to_fixed_angles(C_sg)), C_sg,
                               atol=5 * ROUNDING)


@pytest.mark.parametrize('size', [1e-1, 1e-3, 1e-6])
def test_orthonormalized_leaves_the_square_of_the_error(size):
    """C (I + E), E symmetric, goes to C (I - 3/2 E^2 - 1/2 E^3): worked out by hand."""
    C = rotation.exp(AXES)
    E = size * np.random.default_rng(7).normal(size=(3, 3))
    E = E + E.T
    expected = C @ (np.eye(3) - 1.5 * E @ E - 0.5 * E @ E @ E)
    np.testing.assert_allclose(rotation.orthonormalized(C @ (np.eye(3) + E)), expected,
                               atol=ROUNDING)


def test_orthonormalized_goes_to_the_nearest_rotation():
    moved = rotation.exp(AXES[-1]) + 1e-6 * np.random.default_rng(8).normal(size=(3, 3))
    nearest, stretch = polar(moved)
    square = 1.5 * np.linalg.norm(stretch - np.eye(3))**2
    np.testing.assert_allclose(rotation.orthonormalized(moved), nearest, atol=square + ROUNDING)


@pytest.mark.parametrize('function, shape', [
    (rotation.skew, (3,)), (rotation.exp, (3,)), (rotation.exp_quaternion, (3,)),
    (rotation.from_fixed_angles, (3,)), (rotation.to_matrix, (4,)), (rotation.log, (3, 3)),
    (rotation.to_quaternion, (3, 3)), (rotation.to_fixed_angles, (3, 3)),
    (rotation.orthonormalized, (3, 3))], ids=lambda item: getattr(item, '__name__', None))
def test_leading_axes_are_batches(function, shape):
    items = np.random.default_rng(9).normal(size=(2, 5, *shape))
    if shape == (3, 3):
        items = rotation.exp(items[..., 0])
    whole = function(items)
    for row in range(2):
        for column in range(5):
            # sums of products may be taken in another order
            np.testing.assert_allclose(whole[row, column], function(items[row, column]),
                                       rtol=1e-15, atol=10 * ROUNDING)
