# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Files for other programs, read as those read them."""

import numpy as np
import pytest
import yaml

from instruments import TAN2018
from starcal_ros.config.models import detector
from starcal_ros.core import camera, rotation
from starcal_ros.core.camera import INTRINSICS_KEYS
from starcal_ros.core.units import DEG_PER_HOUR
from starcal_ros.messages import conventions
from starcal_ros.results import export

INTRINSICS = np.array([5.0, 10.0, 25.6, 2e-4, -1e-6, 2e-5, 3e-5])
C_sg = rotation.from_fixed_angles(np.radians([-0.1, 30.0, 359.8]))
RESULT = {'intrinsics': dict(zip(INTRINSICS_KEYS, INTRINSICS.tolist())),
          'mounting': {'quaternion_xyzw': rotation.to_quaternion(C_sg).tolist()},
          'gyro_bias_deg_h': [0.01, 0.02, -0.03], 'gyro_bias_sigma_deg_h': [0.001, 0.002, 0.0015],
          'counts': {'gyro': 90_000}, 'noise_levels': []}
WALK = 'estimator.process_noise.gyro_bias_deg_h_sqrt_h'


@pytest.fixture(scope='module')
def files():
    texts = export.files(RESULT, TAN2018)
    assert sorted(texts) == sorted(export.NAMES)
    return {name: yaml.safe_load(texts[name]) for name in (
        'camera_info.yaml', 'camchain.yaml', 'imu.yaml')}


def opencv(points_o, K, D):
    """Project points in the optical frame as OpenCV and Kalibr's radtan do, raster pixels."""
    x, y = (points_o[:, :2] / points_o[:, 2:]).T
    k1, k2, p1, p2 = D[:4]
    r2 = x**2 + y**2
    radial = 1.0 + k1 * r2 + k2 * r2**2
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2)
    yd = y * radial + p1 * (r2 + 2.0 * y**2) + 2.0 * p2 * x * y
    fx, fy, cx, cy = K
    return np.column_stack((fx * xd + cx, fy * yd + cy))


@pytest.fixture(scope='module')
def seen():
    """Directions in the gyro axes, and where the core sees them, raster pixels."""
    r_s = np.column_stack((np.random.default_rng(1).uniform(-0.12, 0.12, (50, 2)), np.ones(50)))
    uv, *_ = camera.linearize(r_s, INTRINSICS, TAN2018.camera.pixel_pitch_mm)
    return r_s @ C_sg, uv + detector(TAN2018.camera).centre_raster


def test_camera_info_has_the_form_of_camera_info_manager(files):
    info = files['camera_info.yaml']
    assert list(info) == ['image_width', 'image_height', 'camera_name', 'camera_matrix',
                          'distortion_model', 'distortion_coefficients', 'rectification_matrix',
                          'projection_matrix']
    assert (info['image_width'], info['image_height']) == (1024, 1024)
    assert info['distortion_model'] == 'plumb_bob'
    for name, rows, cols in (('camera_matrix', 3, 3), ('distortion_coefficients', 1, 5),
                             ('rectification_matrix', 3, 3), ('projection_matrix', 3, 4)):
        assert (info[name]['rows'], info[name]['cols']) == (rows, cols)
        assert len(info[name]['data']) == rows * cols
        assert all(isinstance(value, float) for value in info[name]['data'])


def test_camera_info_projects_as_the_core(files, seen):
    info = files['camera_info.yaml']
    K, D = info['camera_matrix']['data'], info['distortion_coefficients']['data']
    r_g, uv = seen
    r_o = r_g @ C_sg.T @ conventions.C_os.T
    np.testing.assert_allclose(opencv(r_o, (K[0], K[4], K[2], K[5]), D), uv, atol=1e-9)


def test_camchain_takes_the_gyro_axes_to_pixels_as_the_core(files, seen):
    cam = files['camchain.yaml']['cam0']
    assert (cam['camera_model'], cam['distortion_model']) == ('pinhole', 'radtan')
    T = np.array(cam['T_cam_imu'])
    np.testing.assert_array_equal(T[3], [0.0, 0.0, 0.0, 1.0])
    r_g, uv = seen
    points = r_g @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(opencv(points, cam['intrinsics'], cam['distortion_coeffs']), uv,
                               atol=1e-9)
    assert (cam['resolution'], cam['timeshift_cam_imu']) == ([1024, 1024], 0.0)


def test_camchain_has_the_time_offset_where_it_was_estimated():
    result = {**RESULT, 'augmented': {'names': ['tau_s'], 'estimates': [0.0125]}}
    cam = yaml.safe_load(export.files(result, TAN2018)['camchain.yaml'])['cam0']
    assert cam['timeshift_cam_imu'] == 0.0125


def test_imu_has_the_noise_of_the_scenario_in_si():
    """0.001 deg/sqrt(h) is 2.909e-7 rad/s/sqrt(Hz)."""
    scenario = TAN2018.replace({WALK: 0.6})
    imu = yaml.safe_load(export.files(RESULT, scenario)['imu.yaml'])
    assert (imu['rostopic'], imu['update_rate']) == ('/imu/data_raw', 100.0)
    assert imu['gyroscope_noise_density'] == pytest.approx(2.9089e-7, rel=1e-4)
    # 0.6 deg/h after an hour: 0.01 deg/h after a second
    assert imu['gyroscope_random_walk'] == pytest.approx(0.01 * DEG_PER_HOUR)
    np.testing.assert_allclose(imu['gyroscope_bias'], np.array([0.01, 0.02, -0.03]) * DEG_PER_HOUR)


def test_imu_has_the_random_walk_that_was_found_where_one_was_used():
    level = {'parameter': WALK, 'value': 0.3, 'used': True}
    for used, expected in ((True, 0.3), (False, 0.6)):
        text = export.files({**RESULT, 'noise_levels': [{**level, 'used': used}]},
                            TAN2018.replace({WALK: 0.6}))['imu.yaml']
        assert yaml.safe_load(text)['gyroscope_random_walk'] == pytest.approx(
            expected / 60.0 * DEG_PER_HOUR)
        assert 'Kalibr' not in text


@pytest.mark.parametrize('levels', [[], [{'parameter': WALK, 'value': 0.0, 'used': True}]])
def test_a_bias_that_does_not_walk_gets_the_walk_that_nobody_would_have_seen(levels):
    """Kalibr refuses 0. In 900 s, 0.002 deg/h, the largest sigma: 0.004 deg/h in an hour."""
    text = export.files({**RESULT, 'noise_levels': levels}, TAN2018)['imu.yaml']
    assert yaml.safe_load(text)['gyroscope_random_walk'] == pytest.approx(
        0.004 / 60.0 * DEG_PER_HOUR)
    before = text.partition('gyroscope_random_walk')[0]
    assert 'Kalibr takes no zero' in before and before.endswith('measure it (starcal allan).\n')
