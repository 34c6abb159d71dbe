# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""``starcal intrinsics`` on folders of images: rendered ones give the true camera, real ones that
of others, and what can not be used is named.
"""

from concurrent.futures.process import BrokenProcessPool
import csv
import json
from pathlib import Path
import shutil

from PIL import Image, ImageOps
from astropy.io import fits
from eye import EPOCH, FOV, TRUE, Camera, save
import joblib
import numpy as np
import pytest
from scipy.stats import chi2

from instruments import REAL_SKY
from starcal_ros.calibration.residual_tests import AIR
from starcal_ros.cli import main
from starcal_ros.config.image import CentroidConfig
from starcal_ros.core.utc import unix_ns
from starcal_ros.identification import patterns
from starcal_ros.sky.apparent import Observer
from starcal_ros.sky.refraction import Site, altitude
from starcal_ros.workflows.still_images import (folder as star_folder, measured, opencv_camera,
                                                pipeline, table)

pytest.importorskip('tetra3rs')

SITE = Site(47.0, 8.5, 500.0, 950.0, 5.0)


def errors(result):
    return np.array([result[key] - TRUE[key] for key in opencv_camera.KEYS])


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder of twelve images of two kinds."""
    path, eye = tmp_path_factory.mktemp('sky'), Camera()
    for k in range(12):
        save(path / (f'{k:02d}.png' if k % 2 else f'{k:02d}.fits'), eye.towards(),
             f'2026-03-05T22:{k:02d}:00.25')
    return path


def test_rendered_images_give_the_true_camera(folder, tmp_path, capsys):
    out, page, table = tmp_path / 'c.json', tmp_path / 'p.html', tmp_path / 's.csv'
    assert main(['intrinsics', str(folder), '--fov', FOV, '--heldout', '4', '--epoch', EPOCH,
                 '--out', str(out), '--report', str(page), '--stars', str(table)]) == 0
    result = json.loads(out.read_text())
    error, sigma = errors(result), np.array([result['sigma'][key] for key in opencv_camera.KEYS])
    assert (np.abs(error) < 4.0 * sigma).all()
    assert error @ np.linalg.solve(result['covariance'], error) < chi2.ppf(0.9999, 7)
    assert sigma[0] < 0.2
    assert result['counts']['images'] == 9 and len(result['images']) == 12
    for parts in result['residual_trends'].values():
        assert sum(part['stars'] for part in parts) > 0.9 * result['counts']['stars']
    assert [image['split'] for image in result['images']] == 3 * ['fit', 'fit', 'fit', 'heldout']
    # What the user states, whatever the files say.
    assert {image['utc'] for image in result['images']} == {EPOCH} and result['left_out'] == {}
    # Centroids weigh as their sigmas say: the residuals are those of images that took no part.
    assert result['heldout_rms_px'] == pytest.approx(result['fit_rms_px'], rel=0.25)
    said = capsys.readouterr()
    assert '11.png' in page.read_text() and 'held-out' in said.out
    assert '--epoch takes the place of the times of 00.fits, 02.fits, ' in said.err

    again = tmp_path / 'again.json'
    assert main(['intrinsics', '--centroids', str(table), '--width', '640', '--height', '480',
                 '--epoch', EPOCH, '--out', str(again)]) == 0
    # The table tells no times: minutes.
    assert (np.abs(errors(json.loads(again.read_text())) - error) < 0.05 * sigma).all()


@pytest.mark.slow
def test_any_method_calibrates_and_the_field_may_be_unknown(folder, tmp_path):
    out = tmp_path / 'c.json'
    assert main(['intrinsics', str(folder), '--method', 'angular_distance', '--weighting', 'full',
                 '--out', str(out)]) == 0
    result = json.loads(out.read_text())
    assert abs(result['f_px'] - TRUE['f_px']) < 4.0 * result['sigma']['f_px'] < 2.0
    assert result['images'][0]['utc'] == '2026-03-05T22:00:00.250000'
    assert result['images'][1]['utc'] is None


def test_files_are_measured_alike_one_by_one_and_several_at_once(folder, monkeypatch):
    """Whether workers are started, and whether they live, changes nothing."""
    def told(worth_s, parallel=joblib.Parallel):
        monkeypatch.setattr(measured, '_WORTH_S', worth_s)
        monkeypatch.setattr(joblib, 'Parallel', parallel)
        parts = []
        found = measured.measure(folder, CentroidConfig(), None, parts.append)
        assert parts == sorted(parts) and parts[-1] == 1.0
        return found

    class Lost(joblib.Parallel):
        def __call__(self, tasks):
            yield next(super().__call__(tasks))
            raise BrokenProcessPool

    alone = told(np.inf)
    for other in (told(-1.0), told(-1.0, Lost)):
        assert [image.name for image in other.images] == [image.name for image in alone.images]
        assert (other.left_out, other.notices) == (alone.left_out, alone.notices)
        for left, right in zip(other.images, alone.images, strict=True):
            np.testing.assert_array_equal(left.centroids.uv_raster, right.centroids.uv_raster)


def test_a_folder_in_two_calls_is_the_camera_of_the_command(folder, tmp_path):
    images, out = tmp_path / 'images', tmp_path / 'c.json'
    images.mkdir()
    for k in range(5):
        name = f'{k:02d}.png' if k % 2 else f'{k:02d}.fits'
        shutil.copy(folder / name, images / name)
    (images / 'text.png').write_text('no image')
    bomb = ['SIMPLE  =                    T', 'NAXIS   = 99999999999999', 'END']
    (images / 'bomb.fits').write_text(''.join(line.ljust(80) for line in bomb).ljust(2880))
    # There is no aberration in these images: a part in ten thousand, each its own, is noticed.
    assert main(['intrinsics', str(images), '--fov', FOV, '--heldout', '4', '--aberration',
                 '--out', str(out)]) == 4
    source = pipeline.of_folder(images, pipeline.Conditions(float(FOV), aberration=True), 4)
    assert [*source.left_out] == ['bomb.fits', 'text.png']
    assert 'NAXIS = 99999999999999, at most 9' in source.left_out['bomb.fits']
    assert json.loads(json.dumps(pipeline.calibrate(source).outcome)) == json.loads(
        out.read_text())


def test_an_aberration_that_is_left_out_is_named(tmp_path, capsys):
    eye, images = Camera(Observer('geocentre')), tmp_path / 'images'
    images.mkdir()
    for k in range(6):
        save(images / f'{k}.fits', eye.towards(), EPOCH)
    words = ['intrinsics', str(images), '--fov', FOV, '--out', str(tmp_path / 'c.json')]
    assert main(words) == 4
    assert '--aberration' in ' '.join(capsys.readouterr().out.split())
    assert main([*words, '--aberration', '--overwrite']) == 0
    assert '--aberration' not in capsys.readouterr().out


def test_mirrored_images_are_flipped_and_an_odd_one_is_left_out(folder, tmp_path, capsys):
    images, out, page = tmp_path / 'images', tmp_path / 'c.json', tmp_path / 'p.html'
    images.mkdir()
    for k in (1, 3, 5, 7, 9):
        picture = Image.open(folder / f'{k:02d}.png')
        (picture if k == 5 else ImageOps.flip(picture)).save(images / f'{k:02d}.png')
    (images / 'text.png').write_text('no image')
    Image.new('I;16', (640, 480), 100).save(images / 'dark.png')
    assert main(['intrinsics', str(images), '--fov', FOV, '--out', str(out), '--report',
                 str(page)]) == 0
    result, said = json.loads(out.read_text()), capsys.readouterr().err
    assert result['flipped'] and 'were flipped, top to bottom' in said
    error, sigma = errors(result), np.array([result['sigma'][key] for key in opencv_camera.KEYS])
    assert (np.abs(error) < 4.0 * sigma).all()
    assert list(result['left_out']) == ['05.png', 'dark.png', 'text.png']
    assert 'without a mirror' in result['left_out']['05.png']
    assert 'not identified' in result['left_out']['dark.png']
    assert 'warning: text.png left out: cannot identify image' in said
    assert '<section id="left-out">' in page.read_text()


def horizontal(altitude_deg, count, rising=False):
    """Return directions of an altitude, all around or only in the east, in i."""
    rng, stamp = np.random.default_rng(3), unix_ns(EPOCH)
    any_ = rng.standard_normal((20000, 3))
    any_ /= np.linalg.norm(any_, axis=1, keepdims=True)
    off = np.abs(np.degrees(altitude(any_, np.full(len(any_), stamp), SITE)) - altitude_deg)
    if rising:
        later = np.degrees(altitude(any_, np.full(len(any_), stamp + 2 * 3600 * 10**9), SITE))
        off[later < altitude_deg + 10.0] = np.inf
    return any_[np.argsort(off)[:count]]


@pytest.mark.slow
def test_refraction_biases_a_camera_that_does_not_know_of_it(tmp_path, capsys):
    """Images at 20 deg of altitude: a part in a thousand of f, and none with the site."""
    images, eye = tmp_path / 'images', Camera(Observer('geocentre'), SITE)
    images.mkdir()
    for k, direction in enumerate(horizontal(20.0, 10)):
        save(images / f'{k}.fits', eye.towards(direction), EPOCH)
    results = []
    for words, status in (([], 4), (['--site', '47,8.5,500', '--pressure', '950',
                                     '--temperature', '5'], 0)):
        assert main(['intrinsics', str(images), '--fov', FOV, '--overwrite',
                     '--out', str(tmp_path / 'c.json'),
                     *words]) == status
        results.append(json.loads((tmp_path / 'c.json').read_text()))
    without, corrected = results
    assert abs(errors(without)[0]) > 4.0 * without['sigma']['f_px']
    assert abs(errors(without)[0]) > 1.0
    sigma = np.array([corrected['sigma'][key] for key in opencv_camera.KEYS])
    assert (np.abs(errors(corrected)) < 4.0 * sigma).all() and sigma[0] < 0.3
    assert corrected['fit_rms_px'] < 0.5 * without['fit_rms_px']
    assert corrected['air']['pressure_hpa'] == 950.0
    capsys.readouterr()
    # Half a day later these stars are under the ground, and a site needs a time.
    for path in images.iterdir():
        with fits.open(path, mode='update') as units:
            units[0].header['DATE-OBS'] = '2026-03-06T10:10:00'
    assert main(['intrinsics', str(images), '--fov', FOV, '--site', '47,8.5']) == 2
    assert 'show stars below the horizon: site or times are wrong' in capsys.readouterr().err


@pytest.mark.slow
def test_a_clock_that_another_zone_fits_far_better_is_said(tmp_path, capsys):
    """The camera's clock is two hours ahead; the files say that it is UTC."""
    images, out = tmp_path / 'images', tmp_path / 'c.json'
    eye = Camera(Observer('geocentre'), SITE)
    images.mkdir()
    for k, direction in enumerate(horizontal(15.0, 6, rising=True)):
        save(images / f'{k}.fits', eye.towards(direction), '2026-03-06T00:10:00')
    words = ['intrinsics', str(images), '--fov', FOV, '--site', '47,8.5,500', '--pressure', '950',
             '--temperature', '5', '--overwrite', '--out', str(out)]
    assert main(words) == 4
    found, failed = json.loads(out.read_text()), ''
    for each in found['consistency']:
        if each['name'] == AIR and not each['passed']:
            failed = each['fits']
    assert 'UTC+2' in failed and 'as stated' in failed and '--utc-offset' in found['advice']
    miss = abs(found['f_px'] - TRUE['f_px'])
    assert miss < 4.0 * found['sigma']['f_px'] * np.sqrt(found['variance_factor']['f_px'])
    capsys.readouterr()
    assert main([*words, '--utc-offset', '2']) == 0
    right, said = json.loads(out.read_text()), capsys.readouterr().err
    assert right['images'][0]['utc'] == EPOCH and right['air']['doubt'] == ''
    assert abs(errors(right)[0]) < 4.0 * right['sigma']['f_px'] < miss
    assert AIR in {each['name'] for each in right['consistency'] if each['passed']}
    assert '--utc-offset takes the place of the zone that 0.fits, ' in said


def test_a_site_needs_times(folder, tmp_path, capsys):
    shutil.copy(folder / '01.png', tmp_path)
    assert main(['intrinsics', str(tmp_path), '--fov', FOV, '--site=-33.4,-70.7']) == 1
    said = capsys.readouterr().err
    assert '01.png: the site needs a time, which neither the file nor the epoch tells' in said


@pytest.mark.parametrize('words, culprit', [
    (['nothing'], 'nothing does not exist; needs an .mcap file, a rosbag2 directory, or a folder'),
    (['empty'], 'empty holds no recording and no image'),
    (['images/a.png'], 'images/a.png is one image'),
    (['images', '--width', '64'], '--width: is for --centroids'),
    (['images', '--config', 'x.yaml'], '--config: is for a recording'),
    (['images', '--heldout', '1'], '--heldout: got 1, needs 2 or more'),
    (['images', '--saturation', '-1'], '--saturation: got -1, needs more than 0'),
    (['images', '--epoch', 'soon'], "--epoch: got 'soon', needs an ISO 8601 time"),
    (['images', '--site', '47'], "--site: got '47', needs LAT,LON"),
    (['images', '--site', '97,8'], 'latitude of the site: got 97 deg, allowed is -90 to 90'),
    (['images', '--pressure', '900'], '--pressure: needs --site'),
    (['images', '--stars', 'nowhere/s.csv'], 'nowhere/s.csv: cannot be written'),
    (['one', '--fov', '-3'], 'field of view: got -3 deg, needs more than 0'),
    (['--centroids', 's.csv', '--heldout', '4'], '--heldout: is for a folder of images'),
    (['--centroids', 's.csv', '--width', '9', '--height', '9', '--site', '47,8'],
     '--site: needs --epoch'),
])
def test_command_says_what_is_wrong(words, culprit, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ('empty', 'images', 'one'):
        Path(name).mkdir()
    for name, width in (('a', 64), ('b', 80), ('c', 64)):
        Image.new('L', (width, 48)).save(f'images/{name}.png')
    Image.new('L', (64, 48)).save('one/a.png')
    assert main(['intrinsics', *words]) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if 'reading' not in line]
    assert len(said) == 1 and culprit in said[0]


def test_images_of_which_none_can_be_used_are_named(tmp_path, capsys):
    for k in range(7):
        Image.new('L', (64, 48)).save(tmp_path / f'{k}.png')
    assert main(['intrinsics', str(tmp_path), '--fov', '15']) == 1
    said = capsys.readouterr().err
    assert 'can be used (field of 13.5 to 16.5 deg looked for): 0.png, 1.png, 2.png, ' in said
    assert 'and 2 more: not identified: too few spots' in said and said.count('identified') == 1
    (tmp_path / 'text').mkdir()
    (tmp_path / 'text' / 'a.png').write_text('no image')
    assert main(['intrinsics', str(tmp_path / 'text'), '--fov', '15']) == 1
    assert 'none of its images can be read: a.png: cannot identify' in capsys.readouterr().err


@pytest.mark.parametrize('name, fov, limit, culprit, reference', [
    ('tomc16', '14.3', 0.13, 'mean over the pixel',
     (3230.22, 404.18, 310.87, 0.0907, -0.339, -3.2e-4, 2.3e-4)),
    ('granasat', '27', 0.14, 'lens beyond the model',
     (2657.86, 657.24, 431.17, -0.0314, 0.596, -7.4e-4, -1.1e-3)),
])
def test_real_images_give_the_camera_that_others_found(
        name, fov, limit, culprit, reference, tmp_path):
    """Every fourth image held out, twice as many stars as in the tables of others.

    The spots of the one are narrower than a pixel, and the other has refraction: that is noticed.
    """
    if not (REAL_SKY / name).is_dir():
        pytest.skip(f'{REAL_SKY / name} is not there')
    out = tmp_path / 'camera.json'
    assert main(['intrinsics', str(REAL_SKY / name), '--fov', fov, '--heldout', '4', '--out',
                 str(out)]) == 4
    result = json.loads(out.read_text())
    assert culprit in {each['name'] for each in result['consistency'] if not each['passed']}
    assert result['heldout_rms_px'] < limit and result['left_out'] == {}
    for key, value in zip(opencv_camera.KEYS, reference):
        assert abs(result[key] - value) < 4.0 * result['sigma'][key], key
    with (REAL_SKY / name / 'stars.csv').open() as stream:
        others = len(list(csv.DictReader(stream)))
    assert result['counts']['stars'] + result['counts']['heldout_stars'] > 1.4 * others


def test_images_at_the_same_time_keep_an_order():
    found = table.assemble(list('abc'), [np.ones((1, 2))] * 3, [np.ones(1)] * 3,
                           [False, True, False], EPOCH, stamp_ns=[200, 100, 200])
    assert found.names == ('b', 'a', 'c') and found.heldout.tolist() == [True, False, False]
    assert found.frames.stamp_ns.tolist() == [100, 200, 201]


def test_a_table_of_stars_is_that_of_the_images(folder, tmp_path):
    for name in ('00.fits', '01.png'):
        shutil.copy(folder / name, tmp_path / name)
    found = star_folder.read(tmp_path, float(FOV), EPOCH)
    star_folder.write_table(tmp_path / 's.csv', found.cameras[0].images, [False, True])
    read = table.read_centroids(tmp_path / 's.csv', EPOCH)
    assert read.names == ('00.fits', '01.png') and read.heldout.tolist() == [False, True]
    np.testing.assert_allclose(read.frames.sigma, np.concatenate(
        [image.sigma for image in found.cameras[0].images]), atol=1e-5)


def test_a_missing_library_is_named(folder, capsys, monkeypatch):
    def refuse(name):
        raise ImportError(name)
    monkeypatch.setattr(patterns, 'import_module', refuse)
    patterns.database.cache_clear()
    assert main(['intrinsics', str(folder), '--fov', FOV]) == 2
    assert "pip install 'starcal_ros[identify]'" in capsys.readouterr().err
