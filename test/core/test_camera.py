# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The camera model: exact cases, derivatives, inverse."""

import numpy as np
import pytest

from instruments import INTRINSICS, PITCH_MM
from starcal_ros.core import camera, rotation

PINHOLE = np.array([0.0, 0.0, 25.6, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture
def directions():
    tangents = np.random.default_rng(3).uniform(-0.13, 0.13, (40, 2))
    return np.column_stack((tangents, np.ones(40)))


def test_boresight_falls_on_the_principal_point():
    uv = camera.project(np.array([[0.0, 0.0, 1.0]]), INTRINSICS, PITCH_MM)
    np.testing.assert_array_equal(uv, [[5.0, 10.0]])


def test_projection_has_the_minus_sign_of_T18_equation_3():
    uv = camera.project(np.array([[0.01, 0.02, 1.0]]), PINHOLE, PITCH_MM)
    np.testing.assert_allclose(uv, np.array([[-0.256, -0.512]]) / PITCH_MM, rtol=1e-14)


def test_distortion_reaches_three_pixels_at_the_edge_of_the_detector_as_T18_states():
    """T18 Sec. 3.1: 3 px before calibration; the largest on the edge (not in a corner)."""
    edge = 512 * PITCH_MM / 25.6
    along = np.linspace(-edge, edge, 101)
    r_s = np.concatenate([np.column_stack((along, np.full(101, side), np.ones(101)))
                          for side in (-edge, edge)])
    centred = INTRINSICS.copy()
    centred[:2] = 0.0
    shift = np.linalg.norm(camera.project(r_s, centred, PITCH_MM)
                           - camera.project(r_s, PINHOLE, PITCH_MM), axis=-1)
    assert 2.5 < shift.max() < 3.5


@pytest.mark.parametrize('coefficient, expected', [
    (3, [0.1 * 0.05, 0.2 * 0.05]),                       # k1: x r^2, y r^2
    (4, [0.1 * 0.05**2, 0.2 * 0.05**2]),                 # k2: x r^4, y r^4
    (5, [0.05 + 2 * 0.01, 2 * 0.02]),                    # p1: r^2 + 2 x^2, 2 x y
    (6, [2 * 0.02, 0.05 + 2 * 0.04]),                    # p2: 2 x y, r^2 + 2 y^2
])
def test_each_distortion_term_is_that_of_T18_equation_4(coefficient, expected):
    lens = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    lens[coefficient] = 1.0
    uv = camera.project(np.array([[-0.1, -0.2, 1.0]]), lens, 1.0)   # x = 0.1, y = 0.2 mm
    np.testing.assert_allclose(uv - [[0.1, 0.2]], [expected], rtol=1e-12)


def test_linearize_gives_the_same_centroids_as_project(directions):
    uv, _, _ = camera.linearize(directions, INTRINSICS, PITCH_MM)
    np.testing.assert_allclose(uv, camera.project(directions, INTRINSICS, PITCH_MM), atol=1e-11)


def test_rotation_jacobian_agrees_with_central_differences(directions):
    _, H, _ = camera.linearize(directions, INTRINSICS, PITCH_MM)
    h = 1e-6

    def turned(angle):
        return camera.project(directions @ rotation.exp(angle).T, INTRINSICS, PITCH_MM)

    numeric = np.stack([(turned(h * axis) - turned(-h * axis)) / (2 * h)
                        for axis in np.eye(3)], axis=-1)
    # rounding of uv (1e-13 px) over 2 h, and the h^2 term: 1e-6 px/rad of 4e3
    np.testing.assert_allclose(H, numeric, atol=2e-6)


def test_intrinsics_jacobian_agrees_with_central_differences(directions):
    _, _, H = camera.linearize(directions, INTRINSICS, PITCH_MM)
    step = np.array([1.0, 1.0, 1e-3, 1e-4, 1e-6, 1e-4, 1e-4])
    numeric = np.stack([(camera.project(directions, INTRINSICS + step * axis, PITCH_MM)
                         - camera.project(directions, INTRINSICS - step * axis, PITCH_MM))
                        / (2 * step @ axis) for axis in np.eye(7)], axis=-1)
    scale = np.abs(numeric).max(axis=(0, 1))
    np.testing.assert_allclose(H / scale, numeric / scale, atol=1e-6)


def test_unproject_inverts_project(directions):
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    uv = camera.project(directions, INTRINSICS, PITCH_MM)
    np.testing.assert_allclose(camera.unproject(uv, INTRINSICS, PITCH_MM), unit, atol=1e-14)


def test_backproject_gives_the_same_directions_as_unproject(directions):
    uv = camera.project(directions, INTRINSICS, PITCH_MM)
    np.testing.assert_array_equal(camera.backproject(uv, INTRINSICS, PITCH_MM)[0],
                                  camera.unproject(uv, INTRINSICS, PITCH_MM))


def test_backprojection_jacobians_agree_with_central_differences(directions):
    uv = camera.project(directions, INTRINSICS, PITCH_MM)
    _, by_uv, by_intrinsics = camera.backproject(uv, INTRINSICS, PITCH_MM)
    numeric = np.stack([(camera.unproject(uv + step, INTRINSICS, PITCH_MM)
                         - camera.unproject(uv - step, INTRINSICS, PITCH_MM)) / 2.0
                        for step in np.eye(2)], axis=-1)
    # A step of 1 px is 2.5e-4 rad: the third derivative enters with its square, 6e-8.
    np.testing.assert_allclose(by_uv, numeric, atol=1e-7 * np.abs(numeric).max())
    step = np.array([1.0, 1.0, 1e-2, 1e-6, 1e-8, 1e-6, 1e-6])
    numeric = np.stack([(camera.unproject(uv, INTRINSICS + step * axis, PITCH_MM)
                         - camera.unproject(uv, INTRINSICS - step * axis, PITCH_MM))
                        / (2 * step @ axis) for axis in np.eye(7)], axis=-1)
    scale = np.abs(numeric).max(axis=(0, 1))
    np.testing.assert_allclose(by_intrinsics / scale, numeric / scale, atol=1e-6)


def test_moving_a_star_and_moving_the_camera_under_it_are_inverse(directions):
    """At a fixed direction 0 = dw/duv duv/dp + dw/dp: the implicit function theorem itself."""
    uv, _, H = camera.linearize(directions, INTRINSICS, PITCH_MM)
    _, by_uv, by_intrinsics = camera.backproject(uv, INTRINSICS, PITCH_MM)
    scale = np.abs(by_intrinsics).max(axis=(0, 1))
    np.testing.assert_allclose((by_uv @ H) / scale, -by_intrinsics / scale, atol=1e-12)


@pytest.mark.parametrize('uv', [np.empty((0, 2)), np.zeros((1, 2))])
def test_backproject_takes_no_star_and_one(uv):
    shapes = [part.shape for part in camera.backproject(uv, INTRINSICS, PITCH_MM)]
    assert shapes == [(len(uv), 3), (len(uv), 3, 2), (len(uv), 3, 7)]


def test_leading_axes_are_batches(directions):
    batch = np.stack((INTRINSICS, PINHOLE))
    r_s = np.stack((directions, 1.1 * directions))
    for k, part in enumerate(camera.linearize(r_s, batch, PITCH_MM)):
        for run in range(2):
            np.testing.assert_array_equal(
                part[run], camera.linearize(r_s[run], batch[run], PITCH_MM)[k])
    uv = camera.project(r_s, batch, PITCH_MM)
    for k, part in enumerate(camera.backproject(uv, batch, PITCH_MM)):
        for run in range(2):
            # the runs share the number of Newton steps
            np.testing.assert_allclose(
                part[run], camera.backproject(uv[run], batch[run], PITCH_MM)[k], rtol=1e-12,
                atol=1e-15)


def test_detector_contains_its_pixels_to_their_outer_edge():
    detector = camera.Detector(1024, 768, PITCH_MM)
    inside = detector.contains(np.array([[512.0, 384.0], [512.1, 0.0], [0.0, -384.1]]))
    assert inside.tolist() == [True, False, False]
    np.testing.assert_array_equal(detector.centre_raster, [511.5, 383.5])


def test_distortion_is_what_the_lens_adds_to_the_pinhole(directions):
    pinhole = np.concatenate((INTRINSICS[:3], np.zeros(4)))
    uv = camera.project(directions, pinhole, PITCH_MM)
    np.testing.assert_allclose(camera.distortion(uv, INTRINSICS, PITCH_MM),
                               camera.project(directions, INTRINSICS, PITCH_MM) - uv, atol=1e-11)
