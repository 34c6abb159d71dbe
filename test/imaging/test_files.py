# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images from files of every kind, and files that are none."""

from pathlib import Path

from PIL import Image, ImageFile
from astropy.io import fits
import numpy as np
import pytest

from starcal_ros.imaging.files import ImageFileError, image_files, load

RAMP = np.arange(40 * 60).reshape(40, 60)


@pytest.mark.parametrize('name, counts, top', [
    ('a.png', (RAMP % 251).astype(np.uint8), 255.0),
    ('b.png', (RAMP * 27).astype(np.uint16), 65535.0),
    ('c.tif', (RAMP % 251).astype(np.uint8), 255.0),
    ('d.TIFF', (RAMP * 27).astype(np.uint16), 65535.0),
    ('e.tif', RAMP.astype(np.float32) / 7.0, np.inf)])
def test_grey_images_are_read_as_they_were_written(tmp_path, name, counts, top):
    Image.fromarray(counts).save(tmp_path / name)
    picture = load(tmp_path / name)
    assert picture.counts.dtype == np.float32 and picture.scale.top == top
    np.testing.assert_array_equal(picture.counts, counts.astype(np.float32))


def test_a_jpeg_is_read_to_its_compression(tmp_path):
    smooth = (RAMP / 10.0).astype(np.uint8)
    Image.fromarray(smooth).save(tmp_path / 'a.jpg', quality=95)
    picture = load(tmp_path / 'a.jpg')
    assert picture.counts.shape == (40, 60)
    assert np.abs(picture.counts - smooth).max() <= 4.0


def test_colour_becomes_luminance_and_full_where_a_channel_is(tmp_path):
    colour = np.zeros((20, 20, 3), np.uint8)
    colour[2, 3] = [100, 50, 20]
    colour[4, 5] = [10, 255, 10]
    Image.fromarray(colour).save(tmp_path / 'a.png')
    counts = load(tmp_path / 'a.png').counts
    assert counts[2, 3] == pytest.approx(0.299 * 100 + 0.587 * 50 + 0.114 * 20, rel=1e-5)
    assert counts[4, 5] == 255.0 and counts[0, 0] == 0.0


@pytest.mark.parametrize('mode', ['P', 'LA', 'RGBA', 'CMYK', '1'])
def test_other_kinds_of_pictures_are_grey_too(tmp_path, mode):
    name = 'a.tif' if mode == 'CMYK' else 'a.png'
    Image.fromarray(np.full((20, 30), 255, np.uint8)).convert(mode).save(tmp_path / name)
    counts = load(tmp_path / name).counts
    assert counts.shape == (20, 30)
    assert np.ptp(counts) == 0.0 and counts[0, 0] > 0.0


@pytest.mark.parametrize('order, flipped', [(None, True), ('BOTTOM-UP', True),
                                            ('TOP-DOWN', False)])
def test_the_first_row_of_fits_is_the_top_one(tmp_path, order, flipped):
    unit = fits.PrimaryHDU((RAMP * 27).astype(np.uint16))
    if order:
        unit.header['ROWORDER'] = order
    unit.writeto(tmp_path / 'a.fits')
    picture = load(tmp_path / 'a.fits')
    expected = (RAMP * 27)[::-1] if flipped else RAMP * 27
    np.testing.assert_array_equal(picture.counts, expected)
    assert picture.scale.top == 65535.0


def test_fits_may_hold_its_image_in_an_extension_and_say_when_it_is_full(tmp_path):
    unit = fits.CompImageHDU((RAMP % 1000).astype(np.int16))
    unit.header['SATURATE'] = 900
    fits.HDUList([fits.PrimaryHDU(), unit]).writeto(tmp_path / 'a.fit')
    picture = load(tmp_path / 'a.fit')
    np.testing.assert_array_equal(picture.counts, (RAMP % 1000)[::-1])
    assert picture.scale.top == 900.0


def test_planes_of_fits_are_colours(tmp_path):
    planes = np.stack([np.full((20, 30), value, np.float32) for value in (10.0, 20.0, 30.0)])
    fits.PrimaryHDU(planes).writeto(tmp_path / 'a.fts')
    picture = load(tmp_path / 'a.fts')
    assert picture.counts.shape == (20, 30)
    assert picture.counts[0, 0] == pytest.approx(2.99 + 11.74 + 3.42)


def test_a_folder_is_its_images_in_order(tmp_path):
    for name in ('b.PNG', 'a.jpg', 'c.fits', 'notes.txt'):
        (tmp_path / name).touch()
    assert [path.name for path in image_files(tmp_path)] == ['a.jpg', 'b.PNG', 'c.fits']


def refused(path: Path, text: str | None = None) -> None:
    with pytest.raises(ImageFileError, match=text) as caught:
        load(path)
    assert str(path) in str(caught.value)


def test_a_file_that_is_no_image_is_named(tmp_path):
    (tmp_path / 'a.png').write_text('no image')
    (tmp_path / 'a.fits').write_text('no image')
    refused(tmp_path / 'a.png', 'cannot identify image')
    refused(tmp_path / 'a.fits')
    refused(tmp_path / 'b.png', 'No such file')


@pytest.mark.parametrize('told', [False, True])
def test_a_damaged_image_is_named(told, tmp_path, monkeypatch):
    """Also where another library has told Pillow to take what is cut short for whole."""
    monkeypatch.setattr(ImageFile, 'LOAD_TRUNCATED_IMAGES', told)
    Image.fromarray((RAMP * 27).astype(np.uint16)).save(tmp_path / 'a.png')
    whole = (tmp_path / 'a.png').read_bytes()
    (tmp_path / 'a.png').write_bytes(whole[:len(whole) // 2])
    refused(tmp_path / 'a.png')


def test_what_is_no_plane_is_named(tmp_path):
    fits.PrimaryHDU(np.zeros(30, np.float32)).writeto(tmp_path / 'line.fits')
    fits.PrimaryHDU().writeto(tmp_path / 'empty.fits')
    refused(tmp_path / 'line.fits', r'line.fits: pixels of shape \(30,\)')
    refused(tmp_path / 'empty.fits', 'no image in it')


def test_a_folder_without_images_is_named(tmp_path):
    with pytest.raises(ImageFileError, match='no image in it'):
        image_files(tmp_path)
    with pytest.raises(ImageFileError, match='a folder of images expected'):
        image_files(tmp_path / 'missing')


def taken(path, counts=RAMP.astype(np.uint8), **header):
    """Return when a FITS image with some header was taken."""
    unit = fits.PrimaryHDU(counts)
    for key, value in header.items():
        unit.header[key.replace('_', '-')] = value
    unit.writeto(path / 'a.fits', overwrite=True)
    return load(path / 'a.fits').taken


@pytest.mark.parametrize('header, expected', [
    ({}, None),
    ({'DATE_OBS': '2026-07-02T12:00:00'}, '2026-07-02T12:00:00+00:00'),
    ({'DATE_OBS': '2026-07-02T12:00:00.25', 'EXPTIME': 3.0}, '2026-07-02T12:00:01.750000+00:00'),
    ({'DATE_OBS': '2026-07-02', 'TIME_OBS': '12:00:00.5'}, '2026-07-02T12:00:00.500000+00:00'),
    ({'DATE_OBS': '2026-07-02T12:00:00', 'DATE_AVG': '2026-07-02T12:00:09'},
     '2026-07-02T12:00:09+00:00'),
    ({'DATE_OBS': '2026-07-02T12:00:00', 'EXPTIME': 'long'}, '2026-07-02T12:00:00+00:00'),
    ({'DATE_OBS': '2026-07-02'}, '2026-07-02T00:00:00'),
    ({'DATE_OBS': '2026-07-02T12:00:00', 'TIMESYS': 'TAI'}, None),
    ({'DATE_OBS': 'yesterday'}, None),
    ({'DATE_OBS': 5}, None),
])
def test_fits_says_when_it_was_taken(tmp_path, header, expected):
    when = taken(tmp_path, **header)
    assert (when and when.isoformat()) == expected


@pytest.mark.parametrize('original, gps, expected', [
    ({}, {}, None),
    ({36867: '2026:07:02 14:00:00', 36881: '+02:00'}, {}, '2026-07-02T12:00:00+00:00'),
    ({36867: '2026:07:02 14:00:00', 36881: '+02:00', 37521: '25'}, {},
     '2026-07-02T12:00:00.250000+00:00'),
    ({36867: '2026:07:02 14:00:00'}, {}, '2026-07-02T14:00:00'),
    ({36867: '2026:07:02 14:00:00'}, {29: '2026:07:02', 7: (12.0, 0.0, 0.5)},
     '2026-07-02T12:00:00.500000+00:00'),
    ({36867: '0000:00:00 00:00:00', 36881: '?'}, {29: 'x', 7: (1.0, 2.0)}, None),
])
def test_exif_says_when_it_was_taken(tmp_path, original, gps, expected):
    exif = Image.Exif()
    exif.get_ifd(0x8769).update(original)
    exif.get_ifd(0x8825).update(gps)
    Image.fromarray(RAMP.astype(np.uint8)).save(tmp_path / 'a.jpg', exif=exif)
    when = load(tmp_path / 'a.jpg').taken
    assert (when and when.isoformat()) == expected


@pytest.mark.parametrize('card, damaged', [
    (b'NAXIS1  =                   60', b'NAXIS1  =                  999'),
    (b'NAXIS2  =', b'NAXIX2  ='), (b'BITPIX  =                   16', b'BITPIX  = ?')])
def test_a_damaged_header_of_fits_is_named(tmp_path, card, damaged):
    fits.PrimaryHDU((RAMP * 27).astype(np.int16)).writeto(tmp_path / 'a.fits')
    data = (tmp_path / 'a.fits').read_bytes()
    assert card in data
    (tmp_path / 'a.fits').write_bytes(data.replace(card, damaged.ljust(len(card))))
    refused(tmp_path / 'a.fits')


def test_an_image_of_which_only_the_time_is_damaged_is_read(tmp_path):
    assert taken(tmp_path, DATE_OBS='2026-07-02T12:00:00') is not None
    data = (tmp_path / 'a.fits').read_bytes()
    (tmp_path / 'a.fits').write_bytes(data.replace(b"= '2026-07-02T", b'= ?2026-07-02T'))
    picture = load(tmp_path / 'a.fits')
    assert picture.taken is None and picture.counts.shape == RAMP.shape
