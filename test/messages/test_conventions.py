# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The border to ROS: OpenCV's camera model, REP-103's optical frame, the state on its topic."""

import numpy as np
import pytest

from instruments import PITCH_MM
from starcal_ros.core import camera, rotation
from starcal_ros.filter.belief import Belief, Nominal
from starcal_ros.messages import conventions
from starcal_ros.messages.conventions import C_os

DETECTOR = camera.Detector(1024, 768, PITCH_MM)
# T18 Table 1, with p1 and p2 that can be told apart.
INTRINSICS = np.array([5.0, 10.0, 25.6, 2e-4, -1e-6, 2e-5, -3e-5])


def opencv_plumb_bob(r_o, K, D):
    """Project as OpenCV documents it (calib3d, "Detailed Description")."""
    k1, k2, p1, p2, k3 = D
    x, y = (r_o[..., :2] / r_o[..., 2:]).T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    x_d = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    y_d = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    fx, _, cx, _, fy, cy, *_ = K
    return np.column_stack((fx * x_d + cx, fy * y_d + cy))


@pytest.fixture
def r_s():
    tangents = np.random.default_rng(1).uniform(-0.13, 0.13, (50, 2))
    return np.column_stack((tangents, np.ones(50))) * [[1.7]]


@pytest.fixture
def C_sg():
    return rotation.exp(np.array([0.3, -1.2, 2.0]))


@pytest.fixture
def belief(C_sg):
    """Return a belief with a covariance that has all its correlations."""
    root = np.random.default_rng(2).normal(size=(16, 16))
    nominal = Nominal(rotation.exp(np.array([1.0, 0.5, -0.2])),
                      np.array([1e-8, 2e-8, -3e-8]), C_sg, INTRINSICS)
    return Belief(nominal, np.zeros(16), root)


def test_s_and_o_differ_by_half_a_turn_about_the_boresight():
    half_turn = np.abs(rotation.log(C_os))
    np.testing.assert_array_equal(half_turn, [0.0, 0.0, np.pi])
    assert np.linalg.det(C_os) == 1.0


def test_camera_info_projects_as_opencv_does(r_s):
    info = conventions.camera_info(INTRINSICS, DETECTOR)
    uv_raster = camera.project(r_s, INTRINSICS, DETECTOR.pitch_mm) + DETECTOR.centre_raster
    np.testing.assert_allclose(opencv_plumb_bob(r_s @ C_os.T, info.K, info.D), uv_raster,
                               atol=1e-9)      # pixels of size 1e3, good to some 1e-13


def test_camera_info_has_the_principal_point_in_raster_pixels():
    info = conventions.camera_info(INTRINSICS, DETECTOR)
    assert (info.K[2], info.K[5]) == (511.5 + 5.0, 383.5 + 10.0)


def test_projection_matrix_is_the_camera_matrix_and_no_shift():
    info = conventions.camera_info(INTRINSICS, DETECTOR)
    P = np.reshape(info.P, (3, 4))
    np.testing.assert_array_equal(P[:, :3], np.reshape(info.K, (3, 3)))
    np.testing.assert_array_equal(P[:, 3], 0.0)


def test_numbers_of_camera_info_are_plain_floats():
    info = conventions.camera_info(INTRINSICS, DETECTOR)
    assert [len(part) for part in info] == [9, 5, 12]
    assert all(type(value) is float for part in info for value in part)


def test_from_camera_info_inverts_camera_info():
    info = conventions.camera_info(INTRINSICS, DETECTOR)
    back = conventions.from_camera_info(np.array(info.K), np.array(info.D), DETECTOR)
    # u0 passes through 516.5, rounded by 6e-14; the others through products, relative 1e-15
    np.testing.assert_allclose(back, INTRINSICS, rtol=1e-14, atol=0.0)


def test_mounting_comes_back_from_its_optical_frame(C_sg):
    C_go = conventions.optical_in_gyro(C_sg)
    np.testing.assert_array_equal(conventions.mounting_from_optical(C_go), C_sg)


def test_optical_axes_in_gyro_are_those_of_the_tracker_turned(C_sg):
    """The lens looks along z of both; x to the right is minus x of s."""
    C_go = conventions.optical_in_gyro(C_sg)
    x_s, _, z_s = C_sg                             # rows: the axes of s, resolved in g
    np.testing.assert_array_equal(C_go @ [0.0, 0.0, 1.0], z_s)
    np.testing.assert_array_equal(C_go @ [1.0, 0.0, 0.0], -x_s)


def test_mounting_covariance_is_of_Psi_where_gyro_and_tracker_are_aligned():
    covariance = np.arange(256.0).reshape(16, 16)
    pose = conventions.mounting_covariance(np.eye(3), covariance)
    np.testing.assert_array_equal(pose[3:, 3:], covariance[6:9, 6:9])
    np.testing.assert_array_equal(pose[:3], 0.0)
    np.testing.assert_array_equal(pose[:, :3], 0.0)


def test_mounting_covariance_is_resolved_in_gyro():
    """Where the x axis of the tracker lies along y of the gyro, sigma about x_s is about y_g."""
    C_sg = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    covariance = np.zeros((16, 16))
    covariance[6:9, 6:9] = np.diag([1.0, 2.0, 3.0])         # about x_s = y_g, y_s = z_g, z_s = x_g
    pose = conventions.mounting_covariance(C_sg, covariance)
    np.testing.assert_array_equal(pose[3:, 3:], np.diag([3.0, 1.0, 2.0]))


def test_mounting_covariance_is_that_of_turns_of_the_optical_frame_about_axes_of_gyro(C_sg):
    """Move the mounting by Psi (T18 Eq. 8), and read how its pose has turned."""
    Psi = 1e-6 * np.random.default_rng(3).normal(size=(3, 3))
    turns = [rotation.log(conventions.optical_in_gyro(rotation.exp(row) @ C_sg)
                          @ conventions.optical_in_gyro(C_sg).T) for row in Psi]
    covariance = np.zeros((16, 16))
    covariance[6:9, 6:9] = Psi.T @ Psi
    pose = conventions.mounting_covariance(C_sg, covariance)
    np.testing.assert_allclose(pose[3:, 3:], np.array(turns).T @ turns,
                               atol=1e-20)      # 1e-12 rad^2, turns good to 1e-15 of 1e-6 rad


def test_state_layout_says_what_the_state_vector_holds(belief):
    data = conventions.state_vector(1_500_000_000, belief)
    sizes = [size for _, size in conventions.STATE_LAYOUT]
    assert sizes == [1, 16, 256]
    stamp, state, covariance = np.split(data, np.cumsum(sizes)[:-1])
    assert stamp == [1.5]
    nominal = belief.nominal
    np.testing.assert_allclose(rotation.exp(state[:3]), nominal.C_gi.T, atol=2e-15)
    np.testing.assert_array_equal(state[3:6], nominal.bias)
    np.testing.assert_allclose(rotation.from_fixed_angles(state[6:9]), nominal.C_sg, atol=2e-15)
    np.testing.assert_array_equal(state[9:], nominal.intrinsics)
    np.testing.assert_array_equal(covariance.reshape(16, 16), belief.covariance)


def test_state_vector_gives_the_estimate_and_not_the_nominal_values(belief):
    """An open-loop filter keeps the nominal values and expects an error of them."""
    error = np.zeros(16)
    error[3], error[9] = 2e-9, 0.25
    data = conventions.state_vector(0, Belief(belief.nominal, error, belief.root))
    np.testing.assert_allclose(data[[4, 10]], [1e-8 - 2e-9, 5.0 - 0.25], rtol=1e-15)
