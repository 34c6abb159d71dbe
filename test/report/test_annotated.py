# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Pictures with what was found in them: every star that is drawn is where it is, and why not."""

from base64 import b64decode
from io import BytesIO
import re
import sys

from PIL import Image
import numpy as np
import pytest

from instruments import TOP
from starcal_ros.cli import main
from starcal_ros.core import lenses, rotation
from starcal_ros.core.camera import Detector
from starcal_ros.core.lenses.plumb_bob import Tan2018Lens
from starcal_ros.report import annotated, sky_grid
from starcal_ros.sky import catalog
from starcal_ros.sky.star_names import NAMES, name_of

sys.path.append(str(TOP / 'test' / 'workflows'))

from eye import FOV, Camera, save  # noqa: E402

PIXELS = Detector(800, 600, 0.005)


def near(picture, colour, at, reach=14):
    """Tell whether a colour is in a picture near a place; JPEG changes it a little."""
    u, v = (round(float(part)) for part in at)
    part = np.asarray(picture)[max(v - reach, 0):v + reach, max(u - reach, 0):u + reach]
    red, green, blue = (int(colour[k:k + 2], 16) for k in (1, 3, 5))
    return (np.abs(part.astype(int) - [red, green, blue]).max(axis=-1) < 60).any()


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return two images of the sky, one of no star, and one that is not known."""
    path, eye = tmp_path_factory.mktemp('sky'), Camera()
    for k in range(2):
        save(path / f'{k}.png', eye.towards())
    save(path / 'dark.png', np.full((480, 640), 100, np.uint16))
    save(path / 'nan.fits', np.full((480, 640), np.nan, np.float32))
    return path


@pytest.fixture(scope='module')
def drawn(folder, tmp_path_factory):
    pytest.importorskip('tetra3rs')
    out = tmp_path_factory.mktemp('out')
    assert main(['intrinsics', str(folder), '--fov', FOV, '--annotate', str(out / 'drawn'),
                 '--report', str(out / 'page.html'), '--stars', str(out / 's.csv')]) == 0
    return out


def test_stars_are_ringed_where_they_are(drawn):
    rows = [line.split(',') for line in (drawn / 's.csv').read_text().splitlines()[1:]]
    picture = Image.open(drawn / 'drawn' / '0.png.jpg')
    mine = [row for row in rows if row[0] == '0.png']
    assert len(mine) > 20 and picture.size[0] == 640 and picture.size[1] > 480
    for row in mine:
        assert near(picture, '#40ff60', (float(row[1]), float(row[2])))
    corner = [at for at in ((40, 40), (320, 240), (600, 440), (100, 400)) if min(
        np.hypot(float(row[1]) - at[0], float(row[2]) - at[1]) for row in mine) > 60]
    assert not any(near(picture, '#40ff60', at, 8) for at in corner)


def test_images_that_are_left_out_are_drawn_with_the_reason(drawn, folder):
    names = {path.name for path in (drawn / 'drawn').iterdir()}
    assert names >= {'0.png.jpg', '1.png.jpg', 'dark.png.jpg'}
    page = (drawn / 'page.html').read_text()
    shown = re.findall(r'<figcaption>(.*?)</figcaption><img alt="(.*?)" src="data:image/jpeg;'
                       r'base64,(.*?)"', page)
    captions = {name: text for text, name, _ in shown}
    assert 'left out: not identified: too few spots' in captions['dark.png']
    assert ' stars, 0 refused, of ' in captions['0.png']
    for _, _, data in shown:
        assert len(data) < 300_000 and max(Image.open(BytesIO(b64decode(data))).size) <= 800
    assert 'image with 307200 pixels that are masked or not numbers' in page


def test_a_folder_of_which_nothing_can_be_used_is_drawn(tmp_path, capsys):
    pytest.importorskip('tetra3rs')
    images, out = tmp_path / 'images', tmp_path / 'drawn'
    images.mkdir()
    save(images / 'dark.png', np.full((480, 640), 100, np.uint16))
    words = ['intrinsics', str(images), '--fov', FOV, '--annotate']
    assert main([*words, str(out)]) == 1
    assert [path.name for path in out.iterdir()] == ['dark.png.jpg']
    assert main([*words, str(out)]) == 2
    assert 'is not empty; choose another folder' in capsys.readouterr().err
    assert main([*words, str(images)]) == 2
    assert 'holds the images: choose another folder' in capsys.readouterr().err


@pytest.mark.parametrize('turn', [(0.3, -0.2, 1.0), (1.5, 0.1, 0.0), (-1.57, 0.0, 0.4)])
@pytest.mark.parametrize('lens, values', [
    *((Tan2018Lens(PIXELS.pitch_mm), (f_mm, 0.0, 0.0, 0.0, 0.0)) for f_mm in (3.0, 20.0, 200.0)),
    # Its corners are 95 deg off the axis.
    (lenses.in_pixels('kannala_brandt', PIXELS, 300.0), (300.0, -0.03, 0.004, -0.001, 0.0001))])
def test_lines_of_the_grid_are_lines_of_the_sky(turn, lens, values):
    C_si = rotation.exp(np.array(turn))
    intrinsics = np.array([12.0, -7.0, *values])
    kinds = set()
    for line in sky_grid.lines(C_si, intrinsics, lens, PIXELS):
        r_s = lens.unproject(line.uv_raster - PIXELS.centre_raster, intrinsics)
        x, y, z = (r_s @ C_si).T
        kind, value = line.label.rstrip('°').split()
        kinds.add(kind)
        if kind == 'dec':
            np.testing.assert_allclose(np.degrees(np.arcsin(z)), float(value), atol=1e-6)
        else:
            off = np.degrees(np.arctan2(y, x)) - float(value)
            keep = np.abs(z) < 0.999
            np.testing.assert_allclose((off[keep] + 180.0) % 360.0 - 180.0, 0.0, atol=1e-5)
    assert kinds == {'dec', 'RA'}


def test_names_are_those_of_bright_stars():
    assert len(set(NAMES.values())) == len(NAMES) and name_of(91262) == 'Vega'
    assert name_of(1) == 'HIP 1'
    stars = catalog.load(8.0)
    rows = stars.rows(np.array(list(NAMES)))
    assert stars.magnitude[rows].max() < 3.4
    # Of the fifty brightest Alpha Centauri B and Gamma Velorum have no name of their own.
    bright = stars.hip[np.argsort(stars.magnitude)[:50]]
    assert sum(int(hip) in NAMES for hip in bright) >= 48


def test_a_picture_of_anything_can_be_drawn():
    for counts in (np.full((4, 4), np.nan, np.float32), np.zeros((4, 4), np.float32),
                   np.full((4, 4), np.inf, np.float32)):
        assert annotated._stretched(counts).shape == (4, 4)
