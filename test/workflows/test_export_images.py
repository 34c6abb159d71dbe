# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What still images export: the stars are where astropy reads them, in the sky as it is."""

import csv
import warnings

from astropy.io import fits
from astropy.wcs import WCS
import numpy as np
import pytest

from starcal_ros.cli import main
from starcal_ros.core import lenses, rotation
from starcal_ros.core.camera import Detector
from starcal_ros.core.utc import unix_ns
from starcal_ros.sky import catalog
from starcal_ros.sky.apparent import Observer, apparent_places
from starcal_ros.sky.refraction import Site, altitude, refracted

EPOCH, SITE = '2026-03-05T03:10:00', Site(-33.4, -70.7)
PIXELS, SIGMA = Detector(1280, 960, 1.0), 0.02
LENS = lenses.in_pixels('rational', PIXELS, 1500.0)
VALUES = np.array([14.0, -9.0, 1500.0, -0.1, 0.05, 1e-3, -5e-4, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope='module')
def exported(tmp_path_factory):
    """Return what is exported of six images through the air, and the stars of the first."""
    folder = tmp_path_factory.mktemp('night')
    rng, stars, stamp = np.random.default_rng(3), catalog.load(6.0), unix_ns(EPOCH)
    rows, times = np.arange(len(stars)), np.array([stamp])
    places = apparent_places(stars, rows, times, np.array([len(stars)]), Observer('geocentre'))
    high = np.degrees(altitude(places, np.full(len(stars), stamp), SITE)) > 20.0
    seen = refracted(places, np.full(len(stars), stamp), SITE)
    first = {}
    with (folder / 's.csv').open('w', newline='') as stream:
        table = csv.writer(stream)
        table.writerow(['image', 'u', 'v', 'catalog_id', 'sigma', 'split'])
        for k, aim in enumerate(rng.choice(np.flatnonzero(
                np.degrees(altitude(places, np.full(len(stars), stamp), SITE)) > 45.0), 6)):
            turn = rotation.exp(np.array([0.0, 0.0, rng.uniform(0.0, 6.0)]))
            axis = np.cross([0.0, 0.0, 1.0], seen[aim])
            C_is = rotation.exp(axis / np.linalg.norm(axis) * np.arccos(seen[aim][2])) @ turn
            r_s = seen @ C_is
            there = high & (r_s[:, 2] > 0.7)
            uv = LENS.project(r_s[there], VALUES)
            uv += SIGMA * rng.standard_normal(uv.shape)
            inside = PIXELS.contains(uv)
            for hip, place in zip(stars.hip[there][inside], uv[inside] + PIXELS.centre_raster):
                table.writerow([f'{k}.png', *place, hip, SIGMA, 'heldout' if k == 5 else 'fit'])
            if k == 0:
                first = dict(zip(stars.hip[there][inside].tolist(),
                                 uv[inside] + PIXELS.centre_raster))
    words = ['intrinsics', '--centroids', str(folder / 's.csv'), '--width', '1280', '--height',
             '960', '--epoch', EPOCH, '--site=-33.4,-70.7', '--export', str(folder / 'out')]
    assert main(words) == 0
    return folder / 'out', first, words


def test_a_star_is_where_its_icrs_place_is(exported):
    """Aberration is 0.15 px here, refraction a pixel; proper motion counts to the epoch."""
    folder, first, _ = exported
    stars = catalog.load(6.0)
    rows = stars.rows(list(first))
    u_i = apparent_places(stars, rows, np.array([unix_ns(EPOCH)]), np.array([len(rows)]),
                          Observer('barycentre'))
    sky = np.degrees(np.column_stack((np.arctan2(u_i[:, 1], u_i[:, 0]), np.arcsin(u_i[:, 2]))))
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        found = WCS(fits.getheader(folder / 'wcs' / '0.png.wcs'))
    error = found.all_world2pix(sky, 0) - np.array(list(first.values()))
    assert np.sqrt(np.mean(error**2)) < 1.2 * SIGMA and np.abs(error).max() < 5.0 * SIGMA


def test_each_image_is_there_and_the_folder_is_not_written_over(exported, capsys):
    folder, _, words = exported
    assert sorted(path.name for path in folder.iterdir()) == [
        'camchain.yaml', 'camera_info.yaml', 'cameras.txt', 'images.txt', 'opencv.yaml', 'wcs']
    names = sorted(path.name for path in (folder / 'wcs').iterdir())
    assert names == [f'{k}.png.wcs' for k in range(6)]
    assert (folder / 'images.txt').read_text().count('.png') == 6
    assert main(words) == 2 and 'exists' in capsys.readouterr().err
