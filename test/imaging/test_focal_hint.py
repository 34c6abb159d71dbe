# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What files tell of the focal length."""

from PIL import Image
from astropy.io import fits
import numpy as np
import pytest

from starcal_ros.imaging.files import load

SKY = np.add.outer(np.arange(80), np.arange(120)).astype(np.uint8)     # 3 : 2


def of_picture(path, tags):
    exif = Image.Exif()
    exif.get_ifd(0x8769).update(tags)
    Image.fromarray(SKY).save(path / 'a.jpg', exif=exif)
    return load(path / 'a.jpg').focal_px


@pytest.mark.parametrize('tags, focal_px', [
    ({}, None),
    ({41989: 36}, 120.0),                               # of film, whose diagonal is that of 3 : 2
    ({41989: 0}, None), ({41989: 20000}, None),
    ({37386: 50.0}, None),                              # nothing of the sensor
    # 24 mm and 120 pixels on 24 mm; half as many where the image was scaled
    ({37386: 24.0, 41486: 50.0, 41488: 3}, 120.0),
    ({37386: 24.0, 41486: 127.0, 41488: 2}, 120.0),
    ({37386: 24.0, 41486: 100.0, 41488: 3, 40962: 240}, 120.0),
    # a resolution of prints, not of the sensor
    ({37386: 24.0, 41486: 300.0, 41488: 3, 41989: 36}, 120.0),
])
def test_exif(tmp_path, tags, focal_px):
    assert of_picture(tmp_path, tags) == (None if focal_px is None else pytest.approx(focal_px))


WCS = {'CTYPE1': 'RA---TAN', 'CTYPE2': 'DEC--TAN', 'CRPIX1': 60.0, 'CRPIX2': 40.0,
       'CRVAL1': 10.0, 'CRVAL2': 20.0}
SCALE_DEG = np.degrees(1.0 / 700.0)


@pytest.mark.parametrize('cards, focal_px', [
    ({}, None),
    ({'FOCALLEN': 3.5, 'XPIXSZ': 5.0}, 700.0),
    ({'FOCALLEN': 3.5, 'PIXSIZE1': 5.0}, 700.0),
    ({'FOCALLEN': 0.0, 'XPIXSZ': 5.0}, None), ({'FOCALLEN': 'long', 'XPIXSZ': 5.0}, None),
    ({'SCALE': SCALE_DEG * 3600.0}, 700.0), ({'SECPIX': SCALE_DEG * 3600.0}, 700.0),
    ({**WCS, 'CD1_1': -SCALE_DEG, 'CD1_2': 0.0, 'CD2_1': 0.0, 'CD2_2': SCALE_DEG}, 700.0),
    ({**WCS, 'CD1_1': 0.6 * SCALE_DEG, 'CD1_2': 0.8 * SCALE_DEG, 'CD2_1': -0.8 * SCALE_DEG,
      'CD2_2': 0.6 * SCALE_DEG, 'FOCALLEN': 100.0, 'XPIXSZ': 5.0}, 700.0),
    ({**WCS, 'CDELT1': SCALE_DEG, 'CDELT2': SCALE_DEG}, 700.0),
    ({**WCS, 'CTYPE1': 'nonsense', 'CD1_1': 1.0}, None),
])
def test_fits(tmp_path, cards, focal_px):
    unit = fits.PrimaryHDU(SKY)
    unit.header.update(cards)
    unit.writeto(tmp_path / 'a.fits')
    found = load(tmp_path / 'a.fits').focal_px
    assert found == (None if focal_px is None else pytest.approx(focal_px, rel=1e-6))
