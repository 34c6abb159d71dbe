# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The cameras of W19 and S24: the papers' own equations, derivatives, conversions."""

import numpy as np
import pytest

from starcal_ros.calibration.invariants import Lens
from starcal_ros.core import camera, rotation
from starcal_ros.reproduction import published_cameras

DETECTOR = camera.Detector(1920, 1080, 0.0029)                 # W19 Sec. 4.1
W19 = np.array([1.0, 16.0, 970.0, 550.0, -0.5, 0.5])           # W19 Table 1
OBLONG = np.array([1.03, 16.0, 970.0, 550.0, -0.5, 0.5])
S24 = np.array([767.5, 770.0, 24.4455])


@pytest.fixture
def directions():
    tangents = np.random.default_rng(5).uniform(-1.0, 1.0, (40, 2)) * [0.17, 0.09]
    return np.column_stack((tangents, np.ones(40)))


def printed(r_o, parameters, pitch_mm):
    """Project as W19 Eq. 1 to 7 say, axes o, distortion on the distance from (u0, v0)."""
    s, f, u0, v0, k1, k2 = parameters
    f_u, f_v = f / pitch_mm, f / (s * pitch_mm)
    u = u0 + f_u * r_o[:, 0] / r_o[:, 2]
    v = v0 + f_v * r_o[:, 1] / r_o[:, 2]
    rr = (u - u0)**2 / f_u**2 + (v - v0)**2 / f_v**2
    return np.column_stack((u + (u - u0) * (k1 * rr + k2 * rr**2),
                            v + (v - v0) * (k1 * rr + k2 * rr**2)))


@pytest.mark.parametrize('parameters', [W19, OBLONG])
def test_w19_projects_as_its_equations_say(parameters, directions):
    uv = published_cameras.project_w19(directions, parameters, DETECTOR.pitch_mm)
    np.testing.assert_allclose(
        uv, printed(directions * [-1.0, -1.0, 1.0], parameters, DETECTOR.pitch_mm), atol=1e-10)


def test_w19_with_square_pixels_is_the_projects_camera(directions):
    intrinsics = published_cameras.from_w19(W19, DETECTOR)
    uv = camera.project(directions, intrinsics, DETECTOR.pitch_mm) + DETECTOR.centre_raster
    np.testing.assert_allclose(
        uv, published_cameras.project_w19(directions, W19, DETECTOR.pitch_mm), atol=1e-10)


def test_s24_is_a_pinhole(directions):
    detector = camera.Detector(1536, 1536, 0.0055)
    uv = camera.project(directions, published_cameras.from_s24(S24, detector), 0.0055)
    np.testing.assert_allclose(uv + detector.centre_raster,
                               S24[:2] - S24[2] / 0.0055 * directions[:, :2], atol=1e-10)


@pytest.mark.parametrize('there, back, parameters', [
    (published_cameras.from_w19, published_cameras.to_w19, W19),
    (published_cameras.from_s24, published_cameras.to_s24, S24)])
def test_conversions_are_inverse_over_batches(there, back, parameters):
    batch = parameters * np.array([[1.0], [1.0 + 1e-3]])
    batch[:, 0] = parameters[0]                                # s stays 1
    np.testing.assert_allclose(back(there(batch, DETECTOR), DETECTOR), batch, rtol=1e-14)


@pytest.mark.parametrize('convert, camera_, text', [
    (published_cameras.from_w19, OBLONG, 's = 1.03: .*square'),
    (published_cameras.to_w19, np.array([0, 0, 16.0, 0, 0, 0, 2e-5]), 'p2 = 2e-05: .*tangential'),
    (published_cameras.to_s24, np.array([0, 0, 16.0, -1e-4, 0, 0, 0]), 'k1 = -0.0001: .*pinhole')])
def test_what_can_not_be_represented_is_refused_by_name(convert, camera_, text):
    with pytest.raises(ValueError, match=text):
        convert(camera_, DETECTOR)


STEP = np.array([1e-4, 1e-2, 1.0, 1.0, 1e-3, 1e-2])
"""Small enough that the cubic term, relative 1e-6 or less, stays below the tolerance."""


@pytest.mark.parametrize('parameters', [W19, OBLONG])
def test_w19_derivatives_agree_with_central_differences(parameters, directions):
    pitch_mm = DETECTOR.pitch_mm
    uv, by_rotation, by_parameters = Lens(pitch_mm, published_cameras.square_w19).linearize(
        directions, parameters)
    np.testing.assert_allclose(uv, published_cameras.project_w19(directions, parameters, pitch_mm))
    w_s, dw_duv, dw = published_cameras.backproject_w19(uv, parameters, pitch_mm)
    np.testing.assert_allclose(w_s, published_cameras.unproject_w19(uv, parameters, pitch_mm))
    np.testing.assert_allclose(
        w_s, directions / np.linalg.norm(directions, axis=-1, keepdims=True), atol=1e-14)

    def slope(function, steps):
        return np.stack([(function(step) - function(-step)) / (2.0 * step.sum())
                         for step in steps], axis=-1)

    for analytic, numeric in (
        (by_rotation, slope(lambda step: published_cameras.project_w19(
            directions @ rotation.exp(step).T, parameters, pitch_mm), 1e-6 * np.eye(3))),
        (by_parameters, slope(lambda step: published_cameras.project_w19(
            directions, parameters + step, pitch_mm), np.diag(STEP))),
        (dw_duv, slope(lambda step: published_cameras.unproject_w19(
            uv + step, parameters, pitch_mm), np.eye(2))),
        (dw, slope(lambda step: published_cameras.unproject_w19(
            uv, parameters + step, pitch_mm), np.diag(STEP))),
    ):
        scale = np.abs(numeric).max(axis=(0, 1))
        np.testing.assert_allclose(analytic / scale, numeric / scale, atol=2e-6)


def test_w19_takes_batches(directions):
    batch = np.stack((W19, OBLONG))
    uv = published_cameras.project_w19(directions, batch, DETECTOR.pitch_mm)
    lens = Lens(DETECTOR.pitch_mm, published_cameras.square_w19)
    for k, part in enumerate(lens.linearize(directions, batch)
                             + published_cameras.backproject_w19(uv, batch, DETECTOR.pitch_mm)):
        for run in range(2):
            alone = (lens.linearize(directions, batch[run])
                     + published_cameras.backproject_w19(uv[run], batch[run], DETECTOR.pitch_mm))
            np.testing.assert_allclose(part[run], alone[k], rtol=1e-12, atol=1e-15)
