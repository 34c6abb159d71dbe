# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Lens models: derivatives, inverse, and OpenCV's own numbers."""

import numpy as np
import pytest

from instruments import INTRINSICS, PITCH_MM
from starcal_ros.core import camera, lenses, rotation
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.phased import PhasedLens
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.messages.conventions import camera_info

NAMES = (*lenses.NAMES, 'phased plumb_bob', 'phased kannala_brandt')
DETECTOR = Detector(1280, 960, 1.0)
OPTICAL = np.array([-1.0, -1.0, 1.0])
TERMS = {'rational': [0.12, -0.3, 1e-3, -2e-3, 0.05, 0.4, -0.1, 0.02],
         'thin_prism': [0.12, -0.3, 1e-3, -2e-3, 0.05, 0.4, -0.1, 0.02, 3e-3, -1e-3, -2e-3, 4e-3],
         'equidistant': [], 'kannala_brandt': [-0.03, 0.012, -0.004, 0.0006],
         'polynomial': list(0.01 * np.random.default_rng(4).standard_normal(38))}
IN_PIXELS = sorted(TERMS)


def lens(name):
    """Return a lens model and its values."""
    if name.startswith('phased '):
        optics, values = lens(name.removeprefix('phased '))
        return PhasedLens(optics, DETECTOR), np.array([*values, 0.05, -0.02, 0.03, 0.01])
    if name == lenses.PLUMB_BOB:
        return Tan2018Lens(PITCH_MM), INTRINSICS
    return (lenses.in_pixels(name, DETECTOR, 800.0),
            np.array([3.0, -7.0, 800.0, *TERMS[name]]))


def directions(name, count=60):
    """Return unit vectors all over the field of a lens, the axis among them."""
    widest = {'plumb_bob': 10.0, 'phased plumb_bob': 10.0, 'equidistant': 165.0,
              'kannala_brandt': 130.0}.get(name, 40.0)
    rng = np.random.default_rng(5)
    angle, way = np.radians(widest) * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    angle[0] = 0.0
    return np.column_stack((np.sin(angle) * np.cos(way), np.sin(angle) * np.sin(way),
                            np.cos(angle)))


@pytest.mark.parametrize('name', NAMES)
def test_derivatives_are_those_of_the_projection(name):
    model, values = lens(name)
    r_s = directions(name)
    assert model.ahead(r_s).all() and model.name == name.removeprefix('phased ')
    uv, H_rotation, H_values = model.linearize(r_s, values)
    np.testing.assert_allclose(uv, model.project(r_s, values), rtol=1e-12)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = size = 1e-7 if 'phased' in name else 1e-6      # its waves are short
        there, back = (model.project(r_s @ rotation.exp(way * step).T, values)
                       for way in (1.0, -1.0))
        np.testing.assert_allclose(H_rotation[..., axis], (there - back) / (2.0 * size), rtol=1e-6,
                                   atol=1e-2 if 'phased' in name else 1e-4)
    assert len(model.parameters) == len(values) == H_values.shape[-1] == len(model.scale)
    part = {'plumb_bob': 1.0, 'phased plumb_bob': 1e-2, 'phased kannala_brandt': 1e-6}
    for k, size in enumerate(part.get(name, 1e-4) * model.scale):
        step = np.zeros(len(values))
        step[k] = size
        slope = (model.project(r_s, values + step) - model.project(r_s, values - step)) / (
            2.0 * size)
        np.testing.assert_allclose(H_values[..., k] * size, slope * size, rtol=1e-5,
                                   atol=1e-7 if 'phased' in name else 1e-8)


@pytest.mark.parametrize('name', NAMES)
def test_a_direction_comes_back_from_its_centroid(name):
    model, values = lens(name)
    r_s = directions(name)
    np.testing.assert_allclose(model.unproject(model.project(r_s, values), values), r_s,
                               atol=1e-12)


@pytest.mark.parametrize('name', NAMES)
def test_leading_axes_are_batch_axes(name):
    model, values = lens(name)
    r_s = np.stack((directions(name, 7), directions(name, 7)[::-1]))
    many = np.stack((values, values + 1e-3 * model.scale))
    for found, first, second in zip(model.linearize(r_s, many), model.linearize(r_s[0], many[0]),
                                    model.linearize(r_s[1], many[1])):
        np.testing.assert_allclose(found, np.stack((first, second)), rtol=1e-12, atol=1e-12)
    back = model.unproject(model.project(r_s, many), many)
    np.testing.assert_allclose(back, r_s, atol=1e-12)


AHEAD = [[0.1, -0.2, 1.0], [0.45, 0.3, 1.0], [-0.6, 0.5, 1.0]]
AROUND = [[0.1, -0.2, 1.0], [0.9, 1.1, 0.6], [-2.0, 1.0, 0.1]]


@pytest.mark.parametrize('name, r_o, expected', [
    ('rational', AHEAD, [[718.7187632685382, 322.44247346292354],
                         [967.2014102016009, 698.680273467734],
                         [251.86428211921384, 803.1210982339885]]),
    ('thin_prism', AHEAD, [[718.8367632685382, 322.37047346292354],
                           [967.8349652016009, 698.4860534677339],
                           [253.03060211921388, 803.3358182339884]]),
    ('kannala_brandt', AROUND, [[718.5932004322347, 322.81359913553064],
                                [1217.4981496920245, 1185.8310718458076],
                                [-410.86959038173836, 1005.4347951908692]]),
    ('equidistant', AROUND, [[718.7052914702296, 322.58941705954095],
                             [1233.3868151062786, 1205.2505517965628],
                             [-451.9916647363641, 1025.9958323681822]]),
])
def test_a_lens_is_that_of_opencv(name, r_o, expected):
    """The numbers are what cv2.projectPoints and cv2.fisheye.projectPoints of OpenCV 5.0 give.

    With fx = fy = 800, cx = 640, cy = 480 and the coefficients of TERMS.
    """
    model, values = lens(name)
    values = np.array([0.0, 0.0, *values[2:]])
    uv = model.project(np.array(r_o) * OPTICAL, values)
    np.testing.assert_allclose(uv + [640.0, 480.0], expected, atol=1e-9)


def test_the_rational_lens_holds_the_five_terms():
    model, values = lens('rational')
    info = camera_info(INTRINSICS, Detector(1024, 1024, PITCH_MM))
    values = np.array([*INTRINSICS[:2], info.K[0], *info.D[:4], 0, 0, 0, 0])
    r_s = directions('plumb_bob')
    np.testing.assert_allclose(model.project(r_s, values),
                               camera.project(r_s, INTRINSICS, PITCH_MM), atol=1e-9)


def test_an_equidistant_lens_sees_behind_itself():
    model, values = lens('equidistant')
    angle = np.radians([0.0, 1e-7, 45.0, 90.0, 135.0])
    r_s = np.column_stack((-np.sin(angle), np.zeros(5), np.cos(angle)))
    uv = model.project(r_s, values) - values[:2]
    np.testing.assert_allclose(uv[:, 0], 800.0 * angle, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(uv[:, 1], 0.0)
    uv, H, _ = model.linearize(np.array([[-1.0, 0.0, 0.0]]), values)          # Z = 0, exactly
    np.testing.assert_allclose(uv - values[:2], [[400.0 * np.pi, 0.0]])
    np.testing.assert_allclose(H, [[[0.0, -800.0, 0.0], [0.0, 0.0, 400.0 * np.pi]]], atol=1e-9)


def test_a_coefficient_counts_by_what_it_does_in_the_corner():
    for name in IN_PIXELS:
        model, values = lens(name)
        corner = np.array([[*-(0.5 * np.array([1280, 960])) / 800.0, 1.0]])
        if name in ('equidistant', 'kannala_brandt'):
            angle = model.reach
            corner = np.array([[0.8 * np.sin(angle), 0.6 * np.sin(angle), np.cos(angle)]])
        *_, H = model.linearize(corner, np.array([0.0, 0.0, 800.0, *0.0 * values[3:]]))
        moved = np.linalg.norm(H[0, :, 3:] * model.sigma, axis=0) / (800.0 * model.reach)
        # of a polynomial a term of one axis only, where that is the shorter one
        assert (moved < 1.0).all() and (moved > 0.01).all()
