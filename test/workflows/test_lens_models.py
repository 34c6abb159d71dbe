# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Lens models of still images: each finds itself, the best is chosen, a wrong one is named."""

import csv
import json

import numpy as np
import pytest
from scipy.stats import chi2

from eye import FOV, Camera, save
from starcal_ros.cli import main
from starcal_ros.core import lenses, rotation
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.core.utc import unix_ns
from starcal_ros.messages.conventions import from_camera_info
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import Observer, apparent_places

EPOCH = '2020-01-01T00:00:00'
WIDTH, HEIGHT, SIGMA = 1280, 960, 0.2
PIXELS = Detector(WIDTH, HEIGHT, 0.005)
PRINCIPAL = (14.0, -9.0)
FOCAL_PX = {'equidistant': 420.0, 'kannala_brandt': 420.0}
TERMS = {'rational': (0.3, -0.4, 1e-3, -2e-3, 0.15, 0.1, -0.1, 0.05),
         'thin_prism': (0.3, -0.4, 1e-3, -2e-3, 0.15, 0.1, -0.1, 0.05, 2e-3, 3e-3, -4e-3, 1e-3),
         'equidistant': (), 'kannala_brandt': (-0.03, 0.004, -0.001, 0.0001),
         'polynomial': tuple(0.005 * np.random.default_rng(1).standard_normal(38))}


def camera(name):
    """Return a lens model and its values."""
    f_px = FOCAL_PX.get(name, 900.0)
    if name == lenses.PLUMB_BOB:
        u, v = PIXELS.centre_raster + PRINCIPAL
        return Tan2018Lens(PIXELS.pitch_mm), from_camera_info(
            np.array([f_px, 0, u, 0, f_px, v, 0, 0, 1]),
            np.array([-0.1, 0.05, 1e-3, -5e-4, 0]), PIXELS)
    principal = (0.0, 0.0) if name == 'polynomial' else PRINCIPAL
    return lenses.in_pixels(name, PIXELS, f_px), np.array([*principal, f_px, *TERMS[name]])


def write(path, name, images, seed=1, wrong=0.02, move=lambda uv: 0.0, faintest=4.5,
          own_px=(), sigma=SIGMA):
    """Write the stars of random looks at the sky through a lens, of focal lengths of their own."""
    rng, stars, (lens, values) = np.random.default_rng(seed), catalog.load(faintest), camera(name)
    u_i = apparent_places(stars, np.arange(len(stars)), np.array([unix_ns(EPOCH)]),
                          np.array([len(stars)]), Observer(velocity='barycentre'))
    with path.open('w', newline='') as stream:
        table = csv.writer(stream)
        table.writerow(['image', 'u', 'v', 'catalog_id', 'sigma'])
        for k in range(images):
            r_s = u_i @ rotation.exp(3.0 * rng.standard_normal(3)).T
            seen = r_s[:, 2] > (-0.17 if name in FOCAL_PX else 0.64)     # 100 and 50 deg
            own = np.array([0, 0, own_px[k], *0.0 * values[3:]]) if own_px else 0.0
            uv = lens.project(r_s[seen], values + own)
            uv += move(uv) + sigma * rng.standard_normal(uv.shape)
            hip = np.where(rng.random(len(uv)) < wrong, rng.choice(stars.hip, len(uv)),
                           stars.hip[seen])
            for place, star in zip(uv, hip):
                if PIXELS.contains(place):
                    table.writerow([f'{k}.png', *(place + PIXELS.centre_raster), star, sigma])
    return path


def calibrated(path, *words):
    """Run the command; return its status and result."""
    out = path.with_suffix('.json')
    status = main(['intrinsics', '--centroids', str(path), '--width', str(WIDTH), '--height',
                   str(HEIGHT), '--out', str(out), '--overwrite', *words])
    return status, json.loads(out.read_text())


@pytest.mark.parametrize('name', sorted(TERMS))
def test_each_lens_finds_itself(tmp_path, name, capsys):
    status, found = calibrated(write(tmp_path / 's.csv', name, 4), '--lens', name)
    assert status == 0 and found['lens'] == name and found['lens_models'] == []
    assert found['fit_rms_px'] == pytest.approx(SIGMA, rel=0.1)
    lens, values = camera(name)
    expected = dict(zip(('u0_px', 'v0_px', 'f_px', *lens.parameters[3:]),
                        values + [*PIXELS.centre_raster, *np.zeros(len(values) - 2)]))
    free = [key for key in found['parameters'] if found['sigma'][key] > 0.0]
    assert len(free) == len(expected) - len(lens.held)
    error = np.array([found[key] - expected[key] for key in free])
    rows = [found['parameters'].index(key) for key in free]
    P = np.array(found['covariance'])[np.ix_(rows, rows)]
    scale = np.sqrt(np.diag(P))
    nees = (error / scale) @ np.linalg.solve(P / np.outer(scale, scale), error / scale)
    assert nees < chi2.ppf(0.9999, len(free))
    assert capsys.readouterr().out.count('Verdict: consistent') == 1


@pytest.mark.slow
def test_an_all_sky_lens_is_no_pinhole_and_the_one_that_fits_is_named(tmp_path, capsys):
    """One image of the whole sky."""
    path = write(tmp_path / 's.csv', 'kannala_brandt', 1, faintest=5.0)
    status, found = calibrated(path)
    assert status == 4 and found['lens'] == 'plumb_bob'
    said = capsys.readouterr().out.replace('\n', ' ')
    assert 'of the stars refused: this is no pinhole; kannala_brandt fits with RMS 0.2' in said
    assert found['counts']['rejected_stars'] > 0.15 * found['counts']['stars']
    assert found['lens_models'][0]['lens'] == 'kannala_brandt'

    status, found = calibrated(path, '--lens', 'auto')
    assert status == 0 and found['lens'] == 'kannala_brandt'
    assert found['fit_rms_px'] == pytest.approx(SIGMA, rel=0.1)
    assert found['counts']['rejected_stars'] < 0.05 * found['counts']['stars']


@pytest.mark.slow
@pytest.mark.parametrize('name', ['plumb_bob', 'equidistant', 'rational'])
def test_auto_takes_the_simplest_lens_that_predicts_best(tmp_path, name):
    status, found = calibrated(write(tmp_path / 's.csv', name, 5), '--lens', 'auto')
    assert status == 0 and found['lens'] == name
    tried = {each['lens']: each['predicted_rms_px'] for each in found['lens_models']}
    assert set(tried) <= set(lenses.NAMES) and len(tried) >= 5     # some fit nothing at all
    assert tried[name] < 1.02 * min(tried.values())


def test_where_no_lens_fits_it_is_said(tmp_path, capsys):
    def ripple(uv):
        return np.sin(uv / 50.0) @ [[1.0, 0.5], [0.5, -1.0]]
    path = write(tmp_path / 's.csv', 'plumb_bob', 5, move=ripple)
    status, found = calibrated(path, '--lens', 'auto')
    assert status == 4
    assert (f'no lens model fits, none predicts much better than {found["lens"]}'
            in capsys.readouterr().out.replace('\n', ' '))


@pytest.mark.slow
def test_a_lens_that_lacks_little_is_not_the_last_one(tmp_path, capsys):
    """A fisheye without decentring predicts a decentred pinhole of 15 deg by a tenth as well."""
    pytest.importorskip('tetra3rs')
    eye, folder = Camera(seed=21), tmp_path / 'sky'
    folder.mkdir()
    for k in range(5):
        save(folder / f'{k}.png', eye.towards())
    stars = tmp_path / 'stars.csv'
    assert main(['intrinsics', str(folder), '--fov', FOV, '--stars', str(stars)]) == 0
    capsys.readouterr()
    words = ['intrinsics', '--centroids', str(stars), '--width', '640', '--height', '480']
    assert main([*words, '--lens', 'kannala_brandt']) == 4
    said = capsys.readouterr().out.replace('\n', ' ')
    assert 'plumb_bob does about as well, RMS 0.0' in said and 'no lens model fits' not in said


@pytest.mark.slow
def test_any_lens_may_have_another_focal_length_in_each_image(tmp_path, capsys):
    own_px = (-6.0, 4.0, 9.0, -2.0, 5.0)
    path = write(tmp_path / 's.csv', 'kannala_brandt', 5, own_px=own_px)
    assert calibrated(path, '--lens', 'kannala_brandt')[0] == 4
    capsys.readouterr()
    for lens in ('kannala_brandt', 'auto'):
        status, found = calibrated(path, '--lens', lens, '--free', 'f')
        assert status == 0 and found['lens'] == 'kannala_brandt'
        off = [(each['f_px'] - 420.0 - own_px[int(name[0])]) / each['sigma']
               for name, each in found['own_f_px'].items()]
        assert len(off) == 5 and np.abs(off).max() < 4.0
        assert found['f_px'] == pytest.approx(np.mean(
            [each['f_px'] for each in found['own_f_px'].values()]))


def test_what_the_stars_do_not_tell_is_said(tmp_path, capsys):
    path = write(tmp_path / 's.csv', 'equidistant', 4)
    rows = path.read_text().splitlines()
    kept = [row for row in rows[1:] if np.hypot(float(row.split(',')[1]) - 653.5,
                                                float(row.split(',')[2]) - 470.5) < 250.0]
    path.write_text('\n'.join([rows[0], *kept]))
    _, found = calibrated(path, '--lens', 'kannala_brandt')
    assert 'k4' in found['assumed'] and 'f_px' not in found['assumed']
    said = capsys.readouterr().out.replace('\n', ' ')
    assert 'the stars tell less of' in said and 'k4' in said


@pytest.mark.parametrize('words, culprit', [
    (['--lens', 'rational', '--method', 'angular_distance'],
     '--lens: rational needs the method bundle, got angular_distance'),
    (['--pixel-phase', '--method', 'angular_distance'],
     '--pixel-phase: needs the method bundle, got angular_distance'),
    (['--lens', 'lomography'], "invalid choice: 'lomography'"),
])
def test_a_lens_that_can_not_be_is_refused(tmp_path, words, culprit, capsys):
    path = write(tmp_path / 's.csv', 'plumb_bob', 2)
    try:
        status = main(['intrinsics', '--centroids', str(path), '--width', str(WIDTH),
                       '--height', str(HEIGHT), *words])
    except SystemExit as ended:
        status = ended.code
    assert status == 2 and culprit in capsys.readouterr().err


def test_pixels_that_draw_centroids_are_estimated_where_that_is_asked_for(tmp_path, capsys):
    """0.05 px towards the middle of each pixel, as much as the noise."""
    def drawn(uv):
        return -0.05 * np.sin(2.0 * np.pi * (uv + PIXELS.centre_raster))
    path = write(tmp_path / 's.csv', 'plumb_bob', 6, move=drawn, faintest=5.5, sigma=0.05)
    status, found = calibrated(path)
    assert status == 4 and 'mean over the pixel' in capsys.readouterr().out
    assert found['fit_rms_px'] > 0.058 and 'su_px' not in found['parameters']
    status, found = calibrated(path, '--pixel-phase', '--report', str(tmp_path / 'page.html'),
                               '--export', str(tmp_path / 'export'))
    assert status == 0 and found['fit_rms_px'] == pytest.approx(0.05, rel=0.05)
    for key, true in (('su_px', -0.05), ('cu_px', 0.0), ('sv_px', -0.05), ('cv_px', 0.0),
                      ('f_px', 900.0), ('k1', -0.1), ('k2', 0.05)):
        assert abs(found[key] - true) < 4.5 * found['sigma'][key], key
    assert 'OPENCV 1280 960' in (tmp_path / 'export' / 'cameras.txt').read_text()


@pytest.mark.parametrize('amplitude', [0.15, 0.3])
def test_pixels_may_draw_more_than_expected(tmp_path, amplitude):
    """Up to beyond 1 / 2 pi px, from where on two stars may have one centroid; expected is 0.1."""
    def drawn(uv):
        angle = 2.0 * np.pi * (uv + PIXELS.centre_raster)
        return amplitude * (0.8 * np.sin(angle) + 0.6 * np.cos(angle))
    path = write(tmp_path / 's.csv', 'plumb_bob', 6, move=drawn, faintest=5.5, sigma=0.05)
    status, found = calibrated(path, '--pixel-phase')
    assert status == 0 and found['fit_rms_px'] == pytest.approx(0.05, rel=0.05)
    for key, part in (('su_px', 0.8), ('cu_px', 0.6), ('sv_px', 0.8), ('cv_px', 0.6)):
        assert abs(found[key] - part * amplitude) < 4.5 * found['sigma'][key], key
    for key, true in (('f_px', 900.0), ('k1', -0.1)):
        assert abs(found[key] - true) < 4.5 * found['sigma'][key], key


def test_the_page_shows_a_camera_that_is_no_pinhole(tmp_path):
    page = tmp_path / 'page.html'
    calibrated(write(tmp_path / 's.csv', 'kannala_brandt', 2), '--lens', 'kannala_brandt',
               '--report', str(page))
    text = page.read_text()
    assert 'kannala_brandt' in text and '<section id="distortion">' in text
