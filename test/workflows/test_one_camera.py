# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images of one camera, and images of a camera that moves: what is said, and which sigma holds."""

import csv
import json
from pathlib import Path

from eye import EPOCH, PIXELS, TRUE, Camera, intrinsics
import numpy as np
import pytest
from scipy.stats import chi2

from starcal_ros.calibration.residual_tests import IMAGES
from starcal_ros.cli import main
from starcal_ros.core import camera, rotation

PHONE = Path(__file__).parents[3] / 'shared' / 'data' / 'sky_cases' / 'phone_each_image_its_own_f'
SIGMA_PX = 0.1


def write(path, focal_px, seed):
    """Write a table of stars of images with a focal length each."""
    eye, rows = Camera(seed=seed), []
    bright = eye.stars.magnitude < 6.5
    for k, f_px in enumerate(focal_px):
        r_s = eye.u_i[bright] @ rotation.exp(3.0 * eye.rng.standard_normal(3)).T
        ahead = r_s[:, 2] > 0.98
        uv = camera.project(r_s[ahead], intrinsics(**{**TRUE, 'f_px': f_px}), PIXELS.pitch_mm)
        uv += SIGMA_PX * eye.rng.standard_normal(uv.shape) + PIXELS.centre_raster
        inside = ((uv > 0.0) & (uv < [639.0, 479.0])).all(axis=1)
        rows += [[f'{k}.png', *place, hip, SIGMA_PX] for place, hip in zip(
            uv[inside].tolist(), eye.stars.hip[bright][ahead][inside].tolist())]
    with path.open('w', newline='') as stream:
        csv.writer(stream).writerows([['image', 'u', 'v', 'catalog_id', 'sigma'], *rows])


def calibrated(path, out, *words):
    status = main(['intrinsics', '--centroids', str(path), '--out', str(out), *words])
    return status, json.loads(out.read_text())


def of_table(path, out):
    return calibrated(path, out, '--width', '640', '--height', '480', '--epoch', EPOCH)


@pytest.mark.parametrize('seed', range(3))
def test_one_camera_is_one_camera(tmp_path, seed, capsys):
    write(tmp_path / 's.csv', np.full(8, TRUE['f_px']), seed)
    status, found = of_table(tmp_path / 's.csv', tmp_path / 'c.json')
    assert status == 0 and len(found['each_image']) == 8
    assert not any(each['disagrees'] for each in found['each_image'])
    ratio = np.array([found['sigma_between_images'][key] / found['sigma'][key]
                      for key in found['parameters']])
    # of eight images: chi of seven degrees of freedom over its mean
    assert (0.25 < ratio).all() and (ratio < 2.5).all()
    assert 'sigma, images' in capsys.readouterr().out


@pytest.mark.slow
def test_a_camera_that_moves_has_the_sigma_of_its_images(tmp_path, capsys):
    """The focal length scatters by 5 px, the formal sigma of each image alone is 1 px."""
    miss = []
    for seed in range(6):
        focal_px = TRUE['f_px'] + 5.0 * np.random.default_rng(seed).standard_normal(8)
        write(tmp_path / 's.csv', focal_px, seed)
        (tmp_path / 'c.json').unlink(missing_ok=True)
        status, found = of_table(tmp_path / 's.csv', tmp_path / 'c.json')
        assert status == 4
        told, formal = found['sigma_between_images']['f_px'], found['sigma']['f_px']
        assert formal < 0.6 * told
        miss.append((found['f_px'] - TRUE['f_px']) / told)
        for each in found['each_image']:
            true = focal_px[int(each['image'][0])]
            assert abs(each['f_px'] - true) < 4.5 * each['sigma']['f_px']
        odd = [each['image'] for each in found['each_image'] if each['disagrees']]
        said = capsys.readouterr().out
        assert odd[0] in said and 'the focal lengths of single images scatter by' in said
        assert IMAGES in {each['name'] for each in found['consistency'] if not each['passed']}
        assert 'each has a focal length of its own' in found['advice']
        assert found['variance_factor']['f_px'] >= 0.99 * (told / formal)**2
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], len(miss))
    assert low < np.sum(np.square(miss)) < high


def test_a_focal_length_for_each_image(tmp_path, capsys):
    """The mean of eight that scatter by 5 px, and each, as well as the sigmas say."""
    squares, own, table, out = [], [], tmp_path / 's.csv', tmp_path / 'c.json'
    for seed in range(4):
        focal_px = TRUE['f_px'] + 5.0 * np.random.default_rng(seed).standard_normal(8)
        write(table, focal_px, seed)
        status, found = calibrated(
            table, out, '--width', '640', '--height', '480', '--epoch', EPOCH, '--free', 'f',
            '--overwrite', '--report', str(tmp_path / 'page.html'))
        assert status == 0 and found['consistency'] and found['sigma']['f_px'] < 0.6
        true = np.array([{**TRUE, 'f_px': focal_px.mean()}[key] for key in found['parameters']])
        error = np.array([found[key] for key in found['parameters']]) - true
        squares.append(error @ np.linalg.solve(found['covariance'], error))
        assert len(found['own_f_px']) == 8
        own += [(each['f_px'] - focal_px[int(name[0])]) / each['sigma']
                for name, each in found['own_f_px'].items()]
        assert found['sigma_between_images']['f_px'] > 2.0 * found['sigma']['f_px']
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], 7 * len(squares))
    assert low < np.sum(squares) < high
    # The rest of the camera is shared, and with it most of the errors of one run.
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], len(squares)) / len(squares)
    assert np.abs(own).max() < 4.0 and low < np.mean(np.square(own)) < high
    assert 'f is the mean of the images, which have ' in capsys.readouterr().out
    assert 'f, the rest shared [px]' in (tmp_path / 'page.html').read_text()


def test_a_focal_length_for_each_image_is_for_the_bundle(tmp_path, capsys):
    write(tmp_path / 's.csv', np.full(4, TRUE['f_px']), 1)
    words = ['intrinsics', '--centroids', str(tmp_path / 's.csv'), '--width', '640', '--height',
             '480', '--free']
    for more, culprit in ((['f', '--method', 'angular_distance'],
                           'needs intrinsics.method bundle'),
                          (['f', '--estimate', 'u0'], 'and f in intrinsics.estimate'),
                          (['k9'], "intrinsics.free: got 'k9'")):
        assert main([*words, *more]) == 2
        assert culprit in capsys.readouterr().err


def test_too_few_images_tell_no_scatter(tmp_path):
    write(tmp_path / 's.csv', np.full(3, TRUE['f_px']), 1)
    _, found = of_table(tmp_path / 's.csv', tmp_path / 'c.json')
    assert found['sigma_between_images'] is None and len(found['each_image']) == 3


@pytest.mark.slow
def test_a_phone_whose_lens_moves(tmp_path):
    if not PHONE.is_dir():
        pytest.skip(f'{PHONE} is not there')
    truth = json.loads((PHONE / 'truth.json').read_text())
    width, height = truth['size']
    status, found = calibrated(PHONE / 'stars.csv', tmp_path / 'c.json', '--width', str(width),
                               '--height', str(height))
    assert status == 4
    assert abs(found['f_px'] - truth['joint'][0]) < 0.1
    assert found['sigma']['f_px'] == pytest.approx(truth['joint'][1], rel=0.1)
    assert found['sigma_between_images']['f_px'] == pytest.approx(
        truth['honest_sigma_of_joint'], rel=0.15)
    for each in found['each_image']:
        f_px, sigma = truth['f_px_each'][each['image'][4:8]]
        assert abs(each['f_px'] - f_px) < sigma
    status, own = calibrated(PHONE / 'stars.csv', tmp_path / 'own.json', '--width', str(width),
                             '--height', str(height), '--free', 'f')
    assert own['fit_rms_px'] < 0.95 * found['fit_rms_px']
    assert abs(own['f_px'] - found['f_px']) < truth['honest_sigma_of_joint']
    # The stabiliser moves its principal point, too: that is still held against it.
    assert status == 4 and 'IMG_3048.jpg' in own['own_f_px']
    assert any(each['disagrees'] for each in own['each_image'])
