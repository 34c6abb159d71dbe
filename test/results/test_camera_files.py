# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A camera in the files of other programs, read by their equations; a WCS, read by astropy."""

from io import BytesIO
import re
import warnings

from astropy.io import fits
from astropy.wcs import WCS
import numpy as np
import pytest
import yaml

from starcal_ros.core import lenses, rotation
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.messages import conventions
from starcal_ros.results import camera_files
from starcal_ros.results.camera_files import colmap, wcs
from starcal_ros.results.camera_files.foreign_camera import ForeignCamera

PIXELS = Detector(1280, 960, 0.005)
F_PX, PRINCIPAL = 1100.0, np.array([14.0, -9.0])
TERMS = {'plumb_bob': (-0.12, 0.08, 1e-3, -5e-4),
         'rational': (0.1, -0.1, 1e-3, -5e-4, 0.05, 0.2, -0.05, 0.02),
         'thin_prism': (0.1, -0.1, 1e-3, -5e-4, 0.05, 0.2, -0.05, 0.02, 2e-3, 3e-3, -4e-3, 1e-3),
         'equidistant': (), 'kannala_brandt': (-0.03, 0.004, -0.001, 0.0001),
         'polynomial': tuple(0.002 * np.random.default_rng(1).standard_normal(38))}
C_SI = rotation.exp(np.array([0.4, -1.1, 2.0]))


def camera(name, f_px=F_PX):
    """Return a lens model, its values, and the camera in OpenCV's terms."""
    centre = tuple((PIXELS.centre_raster + PRINCIPAL).tolist())
    foreign = ForeignCamera(name, 1280, 960, f_px, centre, TERMS[name])
    if name == lenses.PLUMB_BOB:
        return Tan2018Lens(PIXELS.pitch_mm), conventions.from_camera_info(
            np.array([f_px, 0, centre[0], 0, f_px, centre[1], 0, 0, 1]),
            np.array([*TERMS[name], 0]), PIXELS), foreign
    return (lenses.in_pixels(name, PIXELS, f_px), np.array([*PRINCIPAL, f_px, *TERMS[name]]),
            foreign)


def pinhole(r_o, D):
    """Distort as OpenCV's documentation has it, up to twelve coefficients."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = [*D, *(0.0,) * (12 - len(D))]
    x, y = (r_o[:, :2] / r_o[:, 2:]).T
    r2 = x**2 + y**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    return np.column_stack((
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2) + s1 * r2 + s2 * r2**2,
        y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y + s3 * r2 + s4 * r2**2))


def fisheye(r_o, D):
    """Distort as OpenCV's documentation of its fisheye has it."""
    theta = np.arccos(r_o[:, 2] / np.linalg.norm(r_o, axis=1))
    distance = theta * (1 + sum(k * theta**(2 * n + 2) for n, k in enumerate(D)))
    return r_o[:, :2] / np.linalg.norm(r_o[:, :2], axis=1)[:, None] * distance[:, None]


class Loader(yaml.SafeLoader):
    """Read the matrices of OpenCV."""


Loader.add_constructor('tag:yaml.org,2002:opencv-matrix', lambda loader, node: np.reshape(
    *(lambda tree: (tree['data'], (tree['rows'], tree['cols'])))(
        loader.construct_mapping(node, deep=True))))


def read_opencv(text):
    """Read a FileStorage; its first line is no YAML 1.1."""
    return yaml.load(text.replace('%YAML:1.0\n', ''), Loader)


@pytest.fixture(scope='module')
def r_s():
    return np.column_stack((np.random.default_rng(1).uniform(-0.4, 0.4, (50, 2)), np.ones(50)))


@pytest.mark.parametrize('name', [name for name in TERMS if name != 'polynomial'])
def test_each_program_sees_the_stars_where_the_lens_has_them(name, r_s):
    lens, values, foreign = camera(name)
    texts, notices = camera_files.files(foreign)
    expected = lens.project(r_s, values) + PIXELS.centre_raster
    r_o = r_s @ conventions.C_os.T
    bent = fisheye if name in ('equidistant', 'kannala_brandt') else pinhole
    seen = {}
    if 'camera_info.yaml' in texts:
        info = yaml.safe_load(texts['camera_info.yaml'])
        K, D = info['camera_matrix']['data'], info['distortion_coefficients']['data']
        assert (info['distortion_model'], len(D)) in (
            ('plumb_bob', 5), ('rational_polynomial', 8), ('equidistant', 4))
        assert (info['distortion_model'] == 'equidistant') == (bent is fisheye)
        # plumb_bob has k3 in the fifth place, and so has the rational one
        seen['ros'] = bent(r_o, D) * K[0] + [K[2], K[5]]
    if 'camchain.yaml' in texts:
        cam = yaml.safe_load(texts['camchain.yaml'])['cam0']
        assert (cam['camera_model'], cam['distortion_model'], len(cam['distortion_coeffs'])) == (
            'pinhole', 'equidistant' if bent is fisheye else 'radtan', 4)
        fu, fv, cu, cv = cam['intrinsics']
        seen['kalibr'] = bent(r_o, cam['distortion_coeffs']) * [fu, fv] + [cu, cv]
    tree = read_opencv(texts['opencv.yaml'])
    assert tree['fisheye_model'] == (bent is fisheye)
    K = tree['camera_matrix']
    seen['opencv'] = bent(r_o, tree['distortion_coefficients'].ravel()) * K[0, 0] + K[:2, 2]
    if 'cameras.txt' in texts:
        number, model, width, height, *parameters = texts['cameras.txt'].splitlines()[-1].split()
        assert (number, int(width), int(height)) == ('1', 1280, 960)
        assert (model, len(parameters)) in (('OPENCV', 8), ('FULL_OPENCV', 12),
                                            ('OPENCV_FISHEYE', 8))
        fx, fy, cx, cy, *D = map(float, parameters)
        seen['colmap'] = bent(r_o, D) * [fx, fy] + [cx - 0.5, cy - 0.5]
    for program, uv in seen.items():
        np.testing.assert_allclose(uv, expected, atol=1e-9, err_msg=program)
    assert bool(notices) == (len(seen) < 4) and len(seen) == {
        'rational': 3, 'thin_prism': 1}.get(name, 4)


def test_a_lens_that_others_have_not_is_said():
    texts, notices = camera_files.files(camera('polynomial')[2])
    assert not texts and len(notices) == 1
    assert 'cameras.txt not written: no such lens' in notices[0]


def test_colmap_turns_the_world_to_the_camera():
    uv = np.array([[10.0, 20.0], [0.0, 0.0]])
    text = colmap.images([colmap.AimedImage('a.png', C_SI, np.zeros(7), uv)])
    lines = [line for line in text.splitlines() if not line.startswith('#')]
    number, w, x, y, z, *place, camera_id, name = lines[0].split()
    assert (number, place, camera_id, name) == ('1', ['0', '0', '0'], '1', 'a.png')
    r_i = np.array([0.3, -0.5, 0.8])
    np.testing.assert_allclose(
        rotation.to_matrix(np.array([*map(float, (x, y, z, w))])) @ r_i,
        conventions.C_os @ C_SI @ r_i, atol=1e-12)
    assert lines[1] == '10.5 20.5 -1 0.5 0.5 -1'


def read_wcs(content):
    """Return astropy's WCS of a file, and its header."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')         # the file has no image, which it remarks on
        header = fits.open(BytesIO(content))[0].header
        return WCS(header), header


@pytest.mark.parametrize('flipped', [False, True])
@pytest.mark.parametrize('name', sorted(TERMS))
def test_astropy_puts_stars_where_the_lens_has_them(name, flipped):
    """To 0.01 px, there and back, as was asked of it; and AP, BP likewise."""
    lens, values, _ = camera(name)
    made = wcs.of_image(lens, values, C_SI, PIXELS, flipped=flipped)
    found, header = read_wcs(made.content)
    uv = np.random.default_rng(2).uniform(-0.5, 0.5, (300, 2)) * [1280, 960]
    u_i = lens.unproject(uv, values) @ C_SI
    raster = uv + PIXELS.centre_raster
    if flipped:
        raster[:, 1] = 959.0 - raster[:, 1]
    sky = np.column_stack((np.degrees(np.arctan2(u_i[:, 1], u_i[:, 0])) % 360.0,
                           np.degrees(np.arcsin(u_i[:, 2]))))
    np.testing.assert_allclose(found.all_world2pix(sky, 0), raster, atol=0.01)
    back = np.radians(found.all_pix2world(raster, 0))
    there = np.column_stack((np.cos(back[:, 1]) * np.cos(back[:, 0]),
                             np.cos(back[:, 1]) * np.sin(back[:, 0]), np.sin(back[:, 1])))
    np.testing.assert_allclose(lens.project(there @ C_SI.T, values), uv, atol=0.01)
    assert made.worst_px < 0.01 and header['A_ORDER'] == made.order
    kind = 'ARC' if name in ('equidistant', 'kannala_brandt') else 'TAN'
    assert header['CTYPE1'] == f'RA---{kind}-SIP' and header['CTYPE2'] == f'DEC--{kind}-SIP'

    ideal = found.wcs_world2pix(sky, 1) - found.wcs.crpix
    order = header['AP_ORDER']
    for axis, table in enumerate(('AP', 'BP')):
        shift = sum(header[f'{table}_{p}_{q}'] * ideal[:, 0]**p * ideal[:, 1]**q
                    for p in range(order + 1) for q in range(order + 1 - p))
        np.testing.assert_allclose((ideal[:, axis] + shift) + found.wcs.crpix[axis] - 1.0,
                                   raster[:, axis], atol=0.05)


def test_a_fisheye_has_a_wcs_beyond_its_horizon():
    lens, values, _ = camera('kannala_brandt', 420.0)
    made = wcs.of_image(lens, values, C_SI, PIXELS)
    found, _ = read_wcs(made.content)
    angle = np.radians(95.0)
    r_s = np.array([[np.sin(angle), 0.0, np.cos(angle)], [-np.sin(angle), 0.0, np.cos(angle)]])
    u_i = r_s @ C_SI
    sky = np.degrees(np.column_stack((np.arctan2(u_i[:, 1], u_i[:, 0]), np.arcsin(u_i[:, 2]))))
    np.testing.assert_allclose(found.all_world2pix(sky, 0),
                               lens.project(r_s, values) + PIXELS.centre_raster, atol=0.02)


def test_further_cards_and_the_time_are_in_the_header():
    lens, values, _ = camera('plumb_bob')
    made = wcs.of_image(lens, values, C_SI, PIXELS,
                        cards=(('DATE-AVG', '2026-03-05T03:10:00', 'middle'),))
    _, header = read_wcs(made.content)
    assert header['DATE-AVG'] == '2026-03-05T03:10:00' and header['RADESYS'] == 'ICRS'
    assert re.match(r'SIMPLE  = +T', made.content[:80].decode())
