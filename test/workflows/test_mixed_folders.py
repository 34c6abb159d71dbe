# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Folders as people have them: several cameras, mosaics of colour filters, cubes."""

import json
import warnings

from PIL import Image
from astropy.io import fits
from eye import FOV, TRUE, Camera, save
import numpy as np
import pytest

from starcal_ros.cli import main

pytest.importorskip('tetra3rs')


def calibrate(folder, out, *words):
    """Return exit status and result of a folder, without any warning of a library."""
    with warnings.catch_warnings():
        warnings.simplefilter('error', RuntimeWarning)
        status = main(['intrinsics', str(folder), '--out', str(out), *words])
    return status, json.loads(out.read_text()) if out.exists() else None


def test_sizes_and_focal_lengths_are_cameras_of_their_own(tmp_path, capsys):
    images, eye = tmp_path / 'sky', Camera()
    zoomed = Camera(seed=2, true={**TRUE, 'f_px': 2700.0})
    images.mkdir()
    for k in range(4):
        save(images / f'a{k}.png', eye.towards())
        if k < 3:
            save(images / f'b{k}.png', zoomed.towards())
        if k < 2:
            save(images / f'c{k}.png', eye.towards()[20:-20, 30:-30])
    (images / 'film.mp4').write_bytes(b'a film')
    status, found = calibrate(images, tmp_path / 'c.json', '--fov', '14.5')
    said = capsys.readouterr()
    assert status in (0, 3)
    cameras = [found, *found['other_cameras']]
    assert [(each['width'], each['height'], each['counts']['images']) for each in cameras] == [
        (640, 480, 4), (640, 480, 3), (580, 440, 2)]
    for each, f_px in zip(cameras, (TRUE['f_px'], 2700.0, TRUE['f_px'])):
        assert abs(each['f_px'] - f_px) < 5.0 * each['sigma']['f_px'] < 8.0
    assert '3 cameras, by size and focal length of the images: 640 x 480 px, f about' in said.err
    assert said.out.count('Verdict') == 3
    assert list(found['left_out']) == ['film.mp4']
    assert 'film.mp4 left out: is a film: write its frames as images' in said.err


@pytest.mark.slow
def test_images_that_were_turned_upright_are_found(tmp_path):
    """The field that is stated is that of the others."""
    images, eye = tmp_path / 'sky', Camera()
    images.mkdir()
    for k in range(5):
        save(images / f'{k}.png', np.rot90(eye.towards()) if k in (0, 3) else eye.towards())
    status, found = calibrate(images, tmp_path / 'c.json', '--fov', FOV)
    assert status in (0, 3) and found['left_out'] == {}
    upright, = found['other_cameras']
    assert (upright['width'], upright['height'], upright['counts']['images']) == (480, 640, 2)
    for each in (found, upright):
        assert abs(each['f_px'] - TRUE['f_px']) < 5.0 * each['sigma']['f_px'] < 8.0


def test_a_mosaic_gives_the_camera_whatever_the_colours_of_the_stars(tmp_path, capsys):
    """Red and blue light of a star differ by two magnitudes."""
    images, eye = tmp_path / 'sky', Camera(psf_sigma_px=1.4, zero_point_electrons_s=4e6)
    images.mkdir()
    for k in range(4):
        uv, magnitude = eye.stars_towards()
        colour = eye.rng.uniform(-1.0, 1.0, len(magnitude))
        mosaic = eye.counts(uv, magnitude)
        mosaic[::2, ::2] = 0.6 * eye.counts(uv, magnitude - colour)[::2, ::2]
        mosaic[1::2, 1::2] = 0.5 * eye.counts(uv, magnitude + colour)[1::2, 1::2]
        unit = fits.PrimaryHDU(mosaic[::-1])
        unit.header['BAYERPAT'] = 'RGGB'
        unit.writeto(images / f'{k}.fits')
    status, found = calibrate(images, tmp_path / 'c.json', '--fov', FOV)
    assert status == 0 and (found['width'], found['height']) == (640, 480)
    for key in ('f_px', 'u0_px', 'v0_px', 'k1'):
        assert abs(found[key] - TRUE[key]) < 4.0 * found['sigma'][key], key
    assert found['sigma']['f_px'] < 0.8
    assert ('0.fits, 1.fits, 2.fits, 3.fits: the green pixels of RGGB are measured'
            in capsys.readouterr().err), 'once'


def test_planes_of_a_cube_are_images(tmp_path, capsys):
    images, eye = tmp_path / 'sky', Camera()
    images.mkdir()
    cube = np.stack([eye.towards()[::-1] for _ in range(4)])
    cube[2] = 100                       # no stars
    fits.PrimaryHDU(cube).writeto(images / 'a.fits')
    status, found = calibrate(images, tmp_path / 'c.json', '--fov', FOV)
    assert status == 0
    assert [each['image'] for each in found['images']] == ['a.fits[0]', 'a.fits[1]', 'a.fits[3]']
    assert list(found['left_out']) == ['a.fits[2]']
    assert 'a.fits: 4 images, each taken as one' in capsys.readouterr().err


@pytest.mark.parametrize('how', ['cut off at 0', 'floats from 0 to 1', 'a border without values'])
def test_counts_of_any_kind_give_the_camera(tmp_path, how):
    images, eye = tmp_path / 'sky', Camera()
    images.mkdir()
    for k in range(4):
        counts = eye.towards().astype(np.float32)
        if how == 'cut off at 0':
            counts = np.clip(counts - np.median(counts) - 8.0, 0.0, None)
            Image.fromarray(counts.astype(np.uint16)).save(images / f'{k}.png')
            continue
        if how == 'floats from 0 to 1':
            counts = counts / 65535.0
        else:
            counts[:, :60] = counts[:20] = np.nan
        fits.PrimaryHDU(counts[::-1]).writeto(images / f'{k}.fits')
    status, found = calibrate(images, tmp_path / 'c.json', '--fov', FOV)
    assert status == 0 and len(found['images']) == 4
    for key in ('f_px', 'u0_px', 'v0_px'):
        assert abs(found[key] - TRUE[key]) < 4.0 * found['sigma'][key], key
    assert found['sigma']['f_px'] < 1.0
