# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Skies of which nothing is known, with more in them than stars, and why some are left out."""

import json
from pathlib import Path
import re

from PIL import Image, ImageDraw
from astropy.io import fits
from eye import FOV, TRUE, Camera, save
import numpy as np
import pytest
from scipy.ndimage import convolve

from starcal_ros.cli import main
from starcal_ros.core import rotation
from starcal_ros.core.lenses.fisheye import EquidistantLens
from starcal_ros.workflows.still_images import search

pytest.importorskip('tetra3rs')
CASES = Path(__file__).parents[3] / 'shared' / 'data' / 'sky_cases'


def run(folder, *words):
    """Return exit status and result of a folder."""
    out = folder.parent / 'camera.json'
    status = main(['intrinsics', str(folder), '--out', str(out), '--overwrite', *words])
    return status, json.loads(out.read_text()) if status in (0, 3, 4) else None


@pytest.fixture
def images(tmp_path):
    folder = tmp_path / 'sky'
    folder.mkdir()
    return folder


def is_right(found, true=TRUE):
    return abs(found['f_px'] - true['f_px']) < 4.0 * found['sigma']['f_px'] < 4.0


# The field

@pytest.mark.parametrize('told', [2700.0, 900.0])
def test_a_file_tells_the_field_and_may_be_wrong(images, told, monkeypatch):
    """Where what it tells is right that is enough; where it is not, all is looked through."""
    monkeypatch.setattr(search, 'RARE_DEG', ())
    monkeypatch.setattr(search, 'FIELD_DEG', (30.0, 40.0) if told > 1000.0 else (14.0, 17.0))
    eye = Camera()
    for k in range(3):
        unit = fits.PrimaryHDU(eye.towards()[::-1])
        unit.header['FOCALLEN'], unit.header['XPIXSZ'] = told * 0.005, 5.0
        unit.writeto(images / f'{k}.fits')
    _, found = run(images)
    assert is_right(found) and found['left_out'] == {}


@pytest.mark.slow
def test_a_wide_field_is_found_without_a_word(images):
    """64 deg, a phone."""
    true = {**TRUE, 'f_px': 512.0, 'k1': -0.02, 'k2': 0.0}
    eye = Camera(true=true, least_cosine=0.6, zero_point_electrons_s=2e5)
    for k in range(2):
        save(images / f'{k}.png', eye.towards())
    _, found = run(images)
    assert is_right(found, true) and found['counts']['images'] == 2


@pytest.mark.parametrize('field_deg, words', [
    *(pytest.param(deg, [], marks=pytest.mark.slow) for deg in (90.0, 100.0)),
    (110.0, ['--fov', '115']), (120.0, ['--fov', '120'])])
def test_very_wide_fields_are_found_beyond_100_deg_where_they_are_stated(images, field_deg, words):
    true = {**TRUE, 'f_px': 320.0 / np.tan(np.radians(field_deg / 2.0)), 'k1': -0.02, 'k2': 0.0}
    eye = Camera(true=true, least_cosine=0.3, zero_point_electrons_s=1e5)
    for k in range(2):
        save(images / f'{k}.png', eye.towards())
    _, found = run(images, *words)
    assert is_right(found, true) and found['counts']['images'] == 2


def test_a_field_beyond_those_is_refused(images, capsys):
    save(images / 'a.png', np.zeros((48, 64), np.uint8))
    table = images.parent / 'stars.csv'
    table.write_text('image,u,v,catalog_id\na.png,1.0,2.0,32349\n')
    for words in ([str(images)], ['--centroids', str(table), '--width', '64', '--height', '48']):
        for field in ('301', '0', '-3', 'nan'):
            assert main(['intrinsics', *words, '--fov', field, '--out',
                         str(images.parent / 'c.json')]) == 2
            assert (f'got {field} deg, needs more than 0, at most 300, of a fisheye beyond 120'
                    in capsys.readouterr().err)


@pytest.mark.slow
def all_sky(folder, focal_px, count=3):
    """Write images of an equidistant lens, to 85 deg from its axis."""
    eye = Camera(zero_point_electrons_s=4e6)
    for k in range(count):
        r_s = eye.u_i @ rotation.exp(3.0 * eye.rng.standard_normal(3)).T
        uv = EquidistantLens(1.0).project(r_s, np.array([7.5, -8.0, focal_px]))
        seen = (r_s[:, 2] > 0.09) & (np.abs(uv) < [330.0, 250.0]).all(axis=1)
        seen &= eye.stars.magnitude < 5.5
        save(folder / f'{k}.png', eye.counts(uv[seen], eye.stars.magnitude[seen]))


@pytest.mark.parametrize('focal_px, words', [
    (153.0, ['--fov', '240']), pytest.param(400.0, [], marks=pytest.mark.slow)])
def test_fisheyes_are_found_and_said_to_be_no_pinhole(
        images, focal_px, words, capsys, monkeypatch):
    monkeypatch.setattr(search, 'RARE_DEG', ((85.0, 94.0),))       # for the sake of time
    all_sky(images, focal_px)
    status, found = run(images, *words)
    said = ' '.join(capsys.readouterr().out.split())
    assert status == 4 and 'this is no pinhole; ' in said and '(--lens ' in said
    status, found = run(images, *words, '--lens', 'equidistant')
    assert len(found['images']) == 3 and found['counts']['stars'] > 250
    for key, true in (('f_px', focal_px), ('u0_px', 327.0), ('v0_px', 231.5)):
        assert abs(found[key] - true) < 4.0 * found['sigma'][key] < 0.2, key


def test_a_file_may_tell_of_a_fisheye(images, monkeypatch):
    """8 mm before a small sensor: no other focal length is tried."""
    monkeypatch.setattr(search, 'FIELD_DEG', (8.0, 9.0))
    monkeypatch.setattr(search.StarSearch, '_fisheyes', lambda self, shape: [])
    monkeypatch.setattr(search, 'RARE_DEG', ())
    all_sky(images, 153.0, count=2)
    for path in [*images.iterdir()]:
        unit = fits.PrimaryHDU(np.asarray(Image.open(path))[::-1])
        unit.header['FOCALLEN'], unit.header['XPIXSZ'] = 8.0, 8000.0 / 150.0
        unit.writeto(path.with_suffix('.fits'))
        path.unlink()
    _, found = run(images, '--lens', 'equidistant')
    assert found['f_px'] == pytest.approx(153.0, abs=0.1) and found['counts']['images'] == 2


@pytest.mark.slow
def test_a_field_of_which_nothing_is_known_may_be_too_narrow(images, monkeypatch, capsys):
    monkeypatch.setattr(search, 'RARE_DEG', ((40.0, 55.0),))
    rng = np.random.default_rng(1)
    save(images / 'a.png', Camera().counts(rng.uniform(-230, 230, (40, 2)),
                                           rng.uniform(2.0, 5.0, 40)))
    assert run(images)[0] == 1
    said = capsys.readouterr().err
    assert 'match no stars of a field of 8 to 55 deg; is the field another one (--fov' in said
    assert 'where the catalogue has fewer than 6 stars?' in said


def test_a_field_without_stars_of_the_catalogue_is_said(images, capsys):
    rng = np.random.default_rng(1)
    sky = rng.normal(100.0, 5.0, (480, 640))
    for u, v in rng.uniform(20, 460, (30, 2)).astype(int):
        sky[v - 1:v + 2, u - 1:u + 2] += 400.0
    save(images / 'a.png', sky.astype(np.uint16))
    assert run(images, '--fov', '0.9')[0] == 1
    said = capsys.readouterr().err
    assert 'a.png: not identified: 30 spots match no stars of a field of 0.81 to 0.99 deg' in said
    assert 'too narrow for the catalogue: such a field holds ' in said
    assert 'it would have to reach magnitude 1' in said


# More than stars

def with_a_tree(eye, bright=20000.0):
    """Return an image of the sky, a quarter of it full of leaves."""
    counts = eye.towards().astype(float)
    leaves = eye.rng.random((480, 160)) < 0.05
    leaves |= np.roll(leaves, 1, axis=0) | np.roll(leaves, 1, axis=1)
    counts[:, :160] += leaves * eye.rng.uniform(0.3, 1.0, leaves.shape) * bright
    return np.clip(counts, 0, 65535).astype(np.uint16)


def test_a_tree_does_not_hide_the_stars(images):
    eye = Camera()
    for k in range(3):
        save(images / f'{k}.png', with_a_tree(eye))
    _, found = run(images, '--fov', FOV)
    assert is_right(found) and found['left_out'] == {}


def with_text(counts, rng):
    """Return an image with a line of bright letters at its edge, as cameras write the time."""
    letters = Image.new('L', (640, 480))
    ImageDraw.Draw(letters).text((5, 460), '2026-03-05 22:10:00 CAM1 EXP 300ms GAIN 12.5', 255)
    return np.clip(counts + 60.0 * np.asarray(letters), 0, 65535).astype(np.uint16)


def with_aurora(counts, rng):
    """Return an image with a bright band across it, in rays."""
    v, u = np.mgrid[:480, :640]
    light = 2000.0 * np.exp(-((v - 200.0 - 60.0 * np.sin(u / 50.0)) / 40.0)**2)
    return np.clip(rng.poisson(counts + light * (1.0 + 0.5 * np.sin(u / 4.0))),
                   0, 65535).astype(np.uint16)


@pytest.mark.parametrize('more', [with_text, with_aurora])
def test_the_clearest_spots_need_not_be_stars(images, more):
    """Their shape is not that of the stars, which are points all the same."""
    eye = Camera(seed=11)
    for k in range(3):
        save(images / f'{k}.png', more(eye.towards(), eye.rng))
    _, found = run(images, '--fov', FOV)
    assert is_right(found) and found['left_out'] == {}
    assert found['counts']['stars'] > 150


@pytest.mark.parametrize('count', [60, 300])
def test_hot_pixels_stand_still_and_stars_do_not(images, count, capsys):
    """Spread by the interpolation of colours they are spots, brighter than most stars."""
    eye = Camera(seed=11)
    hot = np.zeros((480, 640))
    hot[tuple(eye.rng.integers(2, 470, (2, count)))] = eye.rng.uniform(2e3, 2e4, count)
    hot = convolve(hot, np.outer([0.5, 1.0, 0.5], [0.5, 1.0, 0.5]))
    for k in range(4):
        counts = np.clip(eye.towards() + eye.rng.poisson(hot), 0, 65535)
        save(images / f'{k}.png', counts.astype(np.uint16))
    status, found = run(images, '--fov', FOV)
    if count == 60:
        assert is_right(found) and found['left_out'] == {}
    else:                               # of 200 spots hardly any is a star
        assert status == 1
        assert 'of them are at the same place in most images: hot' in capsys.readouterr().err


def test_a_mask_takes_it_out(images, tmp_path, capsys):
    eye = Camera()
    for k in range(2):
        save(images / f'{k}.png', with_a_tree(eye))
    save(images / 'small.png', eye.towards()[:400])
    _, without = run(images, '--fov', FOV)
    mask = np.full((480, 640), 255, np.uint8)
    mask[:, :170] = 0
    Image.fromarray(mask).save(tmp_path / 'mask.png')
    _, found = run(images, '--fov', FOV, '--mask', str(tmp_path / 'mask.png'))
    assert is_right(found)
    assert found['images'][0]['spots'] < without['images'][0]['spots'] < 201
    assert 'the mask has 640 x 480 pixels, the image 640 x 400' in found['left_out']['small.png']
    capsys.readouterr()
    assert main(['intrinsics', str(images), '--mask', str(tmp_path / 'no.png')]) == 1
    assert 'no.png: ' in capsys.readouterr().err


# The clock

@pytest.mark.slow
def test_a_camera_clock_has_the_zone_that_is_stated(tmp_path, capsys):
    """A clock at UTC-7: the refraction of the right time fits far better than that of UTC."""
    case = CASES / 'zone_of_exif'
    if not case.is_dir():
        pytest.skip(f'{case} is not there')
    truth, out = json.loads((case / 'truth.json').read_text()), tmp_path / 'camera.json'
    words = ['intrinsics', str(case), '--fov', '25.7', '--site', '45.5,-122.7,50', '--out',
             str(out), '--overwrite']
    assert main([*words, '--utc-offset=-7']) in (0, 3, 4)
    found, said = json.loads(out.read_text()), capsys.readouterr()
    assert abs(found['f_px'] - truth['f_px']) < 3.0 * truth['sigma']
    assert 'taken as UTC' not in said.err and 'makes the fit worse' not in said.err
    assert 'a clock at' not in said.out
    assert main(words) in (0, 3, 4)
    said = capsys.readouterr()
    assert 'is taken as UTC; --utc-offset states the zone' in said.err
    assert 'the site makes the fit worse' in said.err and 'a clock at UTC-7 or UTC-6' in said.out
    assert json.loads(out.read_text())['fit_rms_px'] > 1.3 * found['fit_rms_px']
    assert main([*words, '--utc-offset', '25']) == 2
    assert '--utc-offset: got 25, needs -14 to 14 h' in capsys.readouterr().err


# Why not

def test_each_image_that_is_left_out_has_its_own_reason(images, capsys):
    eye = Camera()
    save(images / 'good.png', eye.towards())
    save(images / 'dark.png', np.full((480, 640), 100, np.uint16))
    trails = {'streaked.png': np.array([45.0, 20.0]), 'tracking off.png': np.array([-70.0, 90.0])}
    for name, trail in trails.items():
        path = np.array([-0.5, -0.327, 0.0, 0.327, 0.5])[:, None, None] * trail
        save(images / name, eye.renderer.counts(eye.renderer.light(
            eye.rng.uniform(-200, 200, (60, 2)) + path, np.full(60, 2.0))))
    at = np.stack(np.meshgrid(np.arange(-160.0, 0.0, 16.0), np.arange(-160.0, 0.0, 16.0)), axis=-1)
    save(images / 'crowd.png', eye.counts(at.reshape(-1, 2) + eye.rng.uniform(-3, 3, (100, 2)),
                                          eye.rng.uniform(2.0, 4.0, 100)))
    full = eye.counts(eye.rng.uniform(-230, 230, (40, 2)), np.full(40, -4.0))
    save(images / 'full.png', full)
    status, found = run(images, '--fov', FOV)
    assert status in (0, 3)
    why = found['left_out']
    assert list(why) == ['crowd.png', 'dark.png', 'full.png', *trails]
    assert 'too few spots, 0, needs 4' in why['dark.png']
    assert 'clustered: ' in why['crowd.png'] and '--mask' in why['crowd.png']
    assert 'are saturated: expose shorter' in why['full.png']
    for name, trail in trails.items():
        length, angle = (float(word) for word in re.search(
            r'streaked: they are trails of (\d+) px at (\d+) deg', why[name]).groups())
        assert abs(length - np.hypot(*trail)) < 6.0
        assert abs(angle - np.degrees(np.arctan2(-trail[1], trail[0])) % 180.0) < 5.0
    assert 'left out' in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize('case', [
    'black_sky', 'tree', 'float_0_1', 'nan_border', 'rgb16_png', 'mef_4d', 'fz_gz'])
def test_pictures_that_others_brought(case, tmp_path):
    if not (CASES / case).is_dir():
        pytest.skip(f'{CASES / case} is not there')
    truth = json.loads((CASES / case / 'truth.json').read_text())
    out = tmp_path / 'camera.json'
    assert main(['intrinsics', str(CASES / case), '--out', str(out), *truth['args'].split()]
                ) in (0, 3, 4)
    found = json.loads(out.read_text())
    assert abs(found['f_px'] - truth['f_px']) < truth['tolerance_px']
    assert found['counts']['stars'] >= truth.get('least_stars', 35)
