# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images of every kind that people bring: none is cut, and what is not read says how it can be."""

import bz2
import gzip
import struct
import sys
from types import SimpleNamespace

from PIL import Image, features
from astropy.io import fits
import numpy as np
import pytest

from starcal_ros.imaging.lattice import Lattice
from starcal_ros.imaging.files import ImageFileError, image_files, load, pictures

RNG = np.random.default_rng(1)
SKY = RNG.normal(300.0, 12.0, (48, 64)).clip(0).astype(np.uint16)
SKY[20:22, 30:33] = 4000        # a star
COLOUR = np.stack([SKY, SKY + 40, SKY + 17], axis=-1)
GREY = (COLOUR @ np.array([0.299, 0.587, 0.114])).astype(np.float32)


def png16(path, pixels):
    """Write 16-bit colours or grey with alpha, which Pillow does not, as PNG."""
    import zlib
    height, width, channels = pixels.shape

    def part(kind, data):
        return (struct.pack('>I', len(data)) + kind + data
                + struct.pack('>I', zlib.crc32(kind + data)))

    rows = b''.join(b'\0' + row.astype('>u2').tobytes() for row in pixels)
    path.write_bytes(
        b'\x89PNG\r\n\x1a\n' + part(b'IHDR', struct.pack(
            '>IIBBBBB', width, height, 16, {2: 4, 3: 2, 4: 6}[channels], 0, 0, 0))
        + part(b'IDAT', zlib.compress(rows)) + part(b'IEND', b''))


def tiff16(path, pixels, order, planar=False):
    """Write 16-bit colours as TIFF of an order of bytes, together or one after the other."""
    height, width, channels = pixels.shape
    mark = '<' if order == 'II' else '>'
    data = (np.moveaxis(pixels, -1, 0) if planar else pixels).astype(mark + 'u2').tobytes()
    end, parts = 8 + len(data), channels if planar else 1
    tags = [(256, 3, 1, width), (257, 3, 1, height), (258, 3, channels, end),
            (259, 3, 1, 1), (262, 3, 1, 2), (273, 4, parts, end + 6 if planar else 8),
            (277, 3, 1, channels), (278, 3, 1, height),
            (279, 4, parts, end + 18 if planar else len(data)), (284, 3, 1, 2 if planar else 1)]
    bits = struct.pack(f'{mark}{channels}H', *[16] * channels)
    if planar:
        size = len(data) // channels
        bits += struct.pack(f'{mark}6I', *[8 + k * size for k in range(3)], *[size] * 3)
    head = order.encode() + struct.pack(mark + 'HI', 42, 8 + len(data) + len(bits))
    entries = b''.join(
        struct.pack(mark + 'HHI', tag, kind, count)
        + (struct.pack(mark + 'HH', value, 0) if kind == 3 and count == 1
           else struct.pack(mark + 'I', value)) for tag, kind, count, value in tags)
    path.write_bytes(head + data + bits + struct.pack(mark + 'H', len(tags)) + entries
                     + struct.pack(mark + 'I', 0))


@pytest.mark.parametrize('kind', ['png', 'png with alpha', 'tiff II', 'tiff MM', 'ppm',
                                  'tiff planar II', 'tiff planar MM'])
def test_colours_of_16_bits_keep_them(tmp_path, kind):
    path = tmp_path / f'a.{kind.split()[0]}'
    if kind == 'png':
        png16(path, COLOUR)
    elif kind == 'png with alpha':
        png16(path, np.dstack([COLOUR, np.full(SKY.shape, 65535)]))
    elif kind == 'ppm':
        path.write_bytes(b'P6\n64 48\n4095\n' + COLOUR.astype('>u2').tobytes())
    else:
        tiff16(path, COLOUR, kind[-2:], 'planar' in kind)
    picture = load(path)
    np.testing.assert_allclose(picture.counts, GREY, rtol=1e-6)
    assert picture.scale == ((4095.0 if kind == 'ppm' else 65535.0), 1.0)


def test_what_would_be_cut_is_refused(tmp_path):
    png16(tmp_path / 'a.png', np.dstack([SKY, np.full(SKY.shape, 65535)]))
    with pytest.raises(ImageFileError, match='a.png: 16 bits of grey with alpha: save it without'):
        load(tmp_path / 'a.png')


def test_a_tiff_may_have_white_at_0(tmp_path):
    Image.fromarray((65535 - SKY).astype(np.uint16)).save(tmp_path / 'a.tif', tiffinfo={262: 0})
    np.testing.assert_array_equal(load(tmp_path / 'a.tif').counts, SKY)


def test_what_a_name_does_not_tell(tmp_path, monkeypatch):
    """A phone's picture is HEIC whatever it is called; other contents are said to be unknown."""
    monkeypatch.setitem(sys.modules, 'pillow_heif', None)
    (tmp_path / 'a.jpg').write_bytes(b'\0\0\0\x18ftypheic' + bytes(100))
    with pytest.raises(ImageFileError, match='to read HEIC, pillow-heif is needed'):
        load(tmp_path / 'a.jpg')
    (tmp_path / 'b.tif').write_bytes(b'anything')
    with pytest.raises(ImageFileError, match='or of a kind that is not read: save it as PNG'):
        load(tmp_path / 'b.tif')


@pytest.mark.parametrize('name', ['a.bmp', 'a.pgm', 'a.webp', 'a.avif'])
def test_other_pictures_are_read(tmp_path, name):
    if name in ('a.webp', 'a.avif') and not features.check(name[2:]):
        pytest.skip(f'Pillow without {name[2:]}')
    smooth = np.add.outer(np.arange(48), np.arange(64)).astype(np.uint8)
    how = {'a.webp': {'lossless': True}, 'a.avif': {'quality': 95}}.get(name, {})
    Image.fromarray(smooth).save(tmp_path / name, **how)
    assert np.abs(load(tmp_path / name).counts - smooth).max() <= 2.0


def test_pgm_of_16_bits_is_read(tmp_path):
    (tmp_path / 'a.pgm').write_bytes(b'P5\n64 48\n65535\n' + SKY.astype('>u2').tobytes())
    np.testing.assert_array_equal(load(tmp_path / 'a.pgm').counts, SKY)


@pytest.mark.parametrize('name', ['a.fits.gz', 'a.fit.bz2', 'a.fits.fz', 'a.fits'])
def test_packed_fits_is_read(tmp_path, name):
    plain = tmp_path / 'plain.fits'
    fits.PrimaryHDU(SKY).writeto(plain)
    if name == 'a.fits.fz':
        fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(SKY)]).writeto(tmp_path / name)
    else:
        pack = bz2.compress if name.endswith('bz2') else gzip.compress
        (tmp_path / name).write_bytes(pack(plain.read_bytes()))
    plain.unlink()
    assert [path.name for path in image_files(tmp_path)] == [name]
    np.testing.assert_array_equal(load(tmp_path / name).counts, SKY[::-1])


@pytest.mark.parametrize('first', ['thumbnail', 'mask', 'named', 'flat', 'preview'])
def test_of_several_units_the_first_sky_is_taken(tmp_path, first):
    units = {'thumbnail': fits.ImageHDU(SKY[:4, :4]), 'mask': fits.ImageHDU((SKY > 300) * 1),
             'named': fits.ImageHDU(SKY // 2, name='DQ'),
             'flat': fits.ImageHDU(np.random.default_rng(1).normal(1.0, 0.01, (48, 64))),
             'preview': fits.ImageHDU(np.random.default_rng(1).random((20, 20)))}
    primary = fits.PrimaryHDU()
    primary.header['DATE-OBS'] = '2026-07-02T12:00:00'
    fits.HDUList([primary, units[first], fits.ImageHDU(SKY.reshape(1, 1, 48, 64))]
                 ).writeto(tmp_path / 'a.fits')
    picture = load(tmp_path / 'a.fits')
    np.testing.assert_array_equal(picture.counts, SKY[::-1])
    assert picture.note == 'unit 2 of 3 is taken'
    assert picture.taken is not None, 'a unit inherits the header of the first'


def test_planes_pages_and_frames_are_images(tmp_path):
    cube = np.stack([SKY + k for k in range(5)])
    fits.PrimaryHDU(cube).writeto(tmp_path / 'a.fits')
    pages = [Image.fromarray(plane) for plane in cube]
    pages.append(Image.fromarray(SKY[:20, :20]))        # a preview
    pages[0].save(tmp_path / 'a.tif', save_all=True, append_images=pages[1:])
    for name, turn in (('a.fits', -1), ('a.tif', 1)):
        found = list(pictures(tmp_path / name))
        assert len(found) == 5
        for picture, plane in zip(found, cube):
            np.testing.assert_array_equal(picture.counts, plane[::turn])
    for shape, count in (((5, 1), 5), ((1, 5), 5), ((2, 2), 4), ((2, 3), 2)):
        planes = np.broadcast_to(SKY, (*shape, *SKY.shape))
        fits.PrimaryHDU(planes).writeto(tmp_path / 'b.fits', overwrite=True)
        found = list(pictures(tmp_path / 'b.fits'))
        assert len(found) == count, shape
        np.testing.assert_allclose(found[-1].counts, SKY[::-1], rtol=1e-6)


def ser(path, frames, colour=0, depth=16, order='<', stamps=()):
    """Write a film."""
    height, width = frames[0].shape[:2]
    head = struct.pack('<14s7i120s2q', b'LUCAM-RECORDER', 0, colour, 0, width, height, depth,
                       len(frames), b' ' * 120, 0, 0)
    kind = 'u1' if depth == 8 else f'{order}u2'
    path.write_bytes(head + b''.join(frame.astype(kind).tobytes() for frame in frames)
                     + struct.pack(f'<{len(stamps)}q', *stamps))


@pytest.mark.parametrize('order', ['<', '>'])
def test_a_film_is_its_frames(tmp_path, order):
    noon = 639_185_904_000_000_000         # 2026-07-02T12:00:00, in 100 ns from the year 1
    ser(tmp_path / 'a.ser', [SKY, SKY + 3], depth=12, order=order, stamps=(noon, noon + 5_000_000))
    one, two = pictures(tmp_path / 'a.ser')
    np.testing.assert_array_equal(one.counts, SKY)
    np.testing.assert_array_equal(two.counts, SKY + 3)
    assert one.taken.isoformat() == '2026-07-02T12:00:00+00:00'
    assert (two.taken - one.taken).total_seconds() == 0.5 and one.scale.top == 4095.0


def test_a_film_in_colours_and_one_that_is_none(tmp_path):
    ser(tmp_path / 'a.ser', [COLOUR[..., ::-1]], colour=101)
    np.testing.assert_allclose(load(tmp_path / 'a.ser').counts, GREY, rtol=1e-6)
    ser(tmp_path / 'b.ser', [SKY, SKY + 1, SKY], stamps=(1, 2, 3))
    (tmp_path / 'b.ser').write_bytes((tmp_path / 'b.ser').read_bytes()[:-4000])
    one, two = pictures(tmp_path / 'b.ser')
    np.testing.assert_array_equal(two.counts, SKY + 1)
    assert one.note == 'cut short: the first 2 of 3 frames are there' and one.taken is None
    ser(tmp_path / 'b.ser', [SKY])
    (tmp_path / 'b.ser').write_bytes((tmp_path / 'b.ser').read_bytes()[:4000])
    with pytest.raises(ImageFileError, match='cut short: 1 frames of 6144 bytes'):
        load(tmp_path / 'b.ser')
    (tmp_path / 'c.ser').write_bytes(bytes(500))
    with pytest.raises(ImageFileError, match='no SER'):
        load(tmp_path / 'c.ser')


@pytest.mark.parametrize('mark', ['nan', 'blank'])
def test_pixels_without_a_value_are_not_known(tmp_path, mark):
    pixels = SKY.astype(np.int16) if mark == 'blank' else SKY.astype(np.float32)
    pixels[3, 4] = -32768 if mark == 'blank' else np.nan
    unit = fits.PrimaryHDU(pixels)
    if mark == 'blank':
        unit.header['BLANK'] = -32768
    unit.writeto(tmp_path / 'a.fits')
    counts = load(tmp_path / 'a.fits').counts[::-1]
    assert np.isnan(counts[3, 4]) and np.isnan(counts).sum() == 1
    assert counts[5, 6] == SKY[5, 6]


@pytest.mark.parametrize('name, advice', [
    ('a.xisf', 'PixInsight: save it as FITS'), ('a.npy', 'numbers without a head: save them as'),
    ('a.mp4', 'is a film: write its frames as images'),
    ('a.psd', 'save it as PNG or 16-bit TIFF'), ('a.txt', 'no image by its name; PNG, TIFF')])
def test_what_is_not_read_says_how_it_can_be(tmp_path, name, advice):
    (tmp_path / name).write_bytes(b'anything')
    with pytest.raises(ImageFileError, match=advice):
        load(tmp_path / name)
    if name != 'a.txt':
        assert [path.name for path in image_files(tmp_path)] == [name]


@pytest.mark.parametrize('name, extra', [('a.nef', 'raw'), ('a.HEIC', 'heif')])
def test_what_needs_an_extra_says_which(tmp_path, name, extra, monkeypatch):
    for module in ('rawpy', 'pillow_heif'):
        monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b'anything')
    with pytest.raises(ImageFileError, match=rf"pip install 'starcal_ros\[{extra}\]'"):
        load(tmp_path / name)


class Raw(SimpleNamespace):
    """What rawpy opens."""

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return None


def test_a_raw_file_is_a_mosaic(tmp_path, monkeypatch):
    colours = np.tile([[0, 1], [3, 2]], (24, 32)).astype(np.uint8)
    raw = Raw(raw_image_visible=SKY, raw_pattern=colours[:2, :2], raw_colors_visible=colours,
              color_desc=b'RGBG', white_level=15000)
    monkeypatch.setitem(sys.modules, 'rawpy', SimpleNamespace(imread=lambda path: raw))
    (tmp_path / 'a.cr2').write_bytes(b'anything')
    picture = load(tmp_path / 'a.cr2')
    np.testing.assert_array_equal(picture.counts, Lattice(48, 64, 1).of(SKY * 1.0, np.nan))
    assert picture.scale == (15000.0, 1.0)
    assert picture.shape == SKY.shape and 'green pixels of RGGB' in picture.note


@pytest.mark.parametrize('level', [(0.5, 1.0, 1.0, 0.7), (1.0, 0.5, 0.7, 1.0),
                                   (0.5, 1.0, 1.0, 0.5)])
def test_a_mosaic_of_which_the_file_says_nothing_shows_itself(tmp_path, level):
    """As programs write raw frames, and as images without colours are not."""
    sky = SKY * np.tile(np.reshape(level, (2, 2)), (24, 32))
    Image.fromarray(sky.astype(np.uint16)).save(tmp_path / 'a.tif')
    picture = load(tmp_path / 'a.tif')
    assert picture.lattice == (48, 64, 0 if level[0] == 1.0 else 1)
    np.testing.assert_array_equal(picture.counts, picture.lattice.of(SKY * 1.0, np.nan))
    assert 'which the file does not say' in picture.note


@pytest.mark.parametrize('pixels', [
    SKY, SKY + 30 * (np.arange(64) % 2), SKY + 30 * (np.arange(48) % 2)[:, None],
    SKY // 300, np.zeros_like(SKY),
    SKY + np.add.outer(20.0 * np.arange(48), 20.0 * np.arange(64))],
    ids=['sky', 'columns', 'rows', 'few', 'black', 'slope'])
def test_what_is_no_mosaic_is_not_taken_for_one(tmp_path, pixels):
    """Columns that are read by two amplifiers are of two levels, too."""
    Image.fromarray(pixels.astype(np.uint16)).save(tmp_path / 'a.png')
    assert load(tmp_path / 'a.png').lattice is None


def test_three_exposures_are_not_colours(tmp_path):
    rng, planes = np.random.default_rng(2), []
    for _ in range(3):
        plane = rng.normal(300.0, 12.0, (96, 128)) + np.linspace(0.0, 900.0, 128)
        for u, v in rng.integers(4, 92, (12, 2)):
            plane[v - 1:v + 2, u - 1:u + 2] += 800.0
        plane[::17, ::19] = 5000.0                      # hot pixels
        planes.append(plane.astype(np.uint16))
    fits.PrimaryHDU(np.stack(planes)).writeto(tmp_path / 'a.fits')
    assert len(list(pictures(tmp_path / 'a.fits'))) == 3
    colours = [planes[0], planes[0] + 70, planes[0] // 2]
    fits.PrimaryHDU(np.stack(colours)).writeto(tmp_path / 'b.fits')
    picture, = pictures(tmp_path / 'b.fits')
    assert picture.note == 'its three planes show the same stars: they are colours'


@pytest.mark.parametrize('name, head, said', [
    ('a.png', b'', 'a.png: empty'), ('a.fits', b'', 'a.fits: empty'),
    ('a.tif', b'II*\0' + bytes(100), 'TIFF of a kind that is not read, such as floats'),
    ('a.jpg', b'<html>', 'none, or of a kind that is not read: save it as PNG'),
    ('a.fits', b'SIMPLX' + bytes(100), 'damaged: not FITS: it does not begin')])
def test_what_is_no_image_is_said_in_plain_words(tmp_path, name, head, said):
    (tmp_path / name).write_bytes(head)
    with pytest.raises(ImageFileError, match=said) as caught:
        load(tmp_path / name)
    assert 'Error' not in str(caught.value) and str(caught.value).count(name) == 1


def test_a_missing_image_is_said_in_plain_words(tmp_path):
    with pytest.raises(ImageFileError, match='a.png: No such file or directory$'):
        load(tmp_path / 'a.png')


@pytest.mark.parametrize('order', [None, 'TOP-DOWN', 'BOTTOM-UP'])
@pytest.mark.parametrize('where', ['falling', 'rising'])
def test_the_level_of_the_sky_tells_which_pixels_are_green(tmp_path, where, order):
    """A header may mean its pattern from either end."""
    sky = SKY.astype(float)
    sky[::2, ::2] *= 0.5 if where == 'rising' else 1.0
    sky[1::2, 1::2] *= 0.7 if where == 'rising' else 1.0
    sky[::2, 1::2] *= 0.5 if where == 'falling' else 1.0
    sky[1::2, ::2] *= 0.7 if where == 'falling' else 1.0
    unit = fits.PrimaryHDU(sky.astype(np.uint16)[::-1 if order != 'TOP-DOWN' else 1])
    unit.header['BAYERPAT'] = 'RGGB'
    if order:
        unit.header['ROWORDER'] = order
    unit.writeto(tmp_path / 'a.fits')
    picture = load(tmp_path / 'a.fits')
    assert picture.lattice == (48, 64, 0 if where == 'falling' else 1)
    np.testing.assert_array_equal(picture.counts, picture.lattice.of(SKY * 1.0, np.nan))
