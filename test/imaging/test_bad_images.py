# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Images that are small as files and large in memory, and damaged ones of every kind."""

import gzip
import os
import struct
import time
import zlib

from PIL import Image
from astropy.io import fits
import numpy as np
import pytest

from starcal_ros.files.limits import IMAGE
from starcal_ros.imaging.files import ImageFileError, load

ROWS, COLUMNS = np.mgrid[:64, :80]
STARS = (100.0 + 1000.0 * np.exp(-((COLUMNS - 40)**2 + (ROWS - 30)**2) / 20.0)).astype(np.uint16)
NOISE = np.random.default_rng(1).integers(0, 60000, (64, 80)).astype(np.uint16)


def png(width, height):
    """Make a PNG of a size, all of it zeros."""
    def part(kind, data):
        return (struct.pack('>I', len(data)) + kind + data
                + struct.pack('>I', zlib.crc32(kind + data)))
    head = struct.pack('>IIBBBBB', width, height, 8, 0, 0, 0, 0)
    return (b'\x89PNG\r\n\x1a\n' + part(b'IHDR', head) + part(b'IDAT', zlib.compress(bytes(1000)))
            + part(b'IEND', b''))


def cards(*lines):
    """Make the header of a FITS file."""
    text = ''.join(line.ljust(80) for line in ('SIMPLE  =                    T',
                                               'BITPIX  =                   16', *lines, 'END'))
    return text.ljust(-(-len(text) // 2880) * 2880).encode()


def naxis(*axes):
    """Make the cards of some axes."""
    return [f'NAXIS   = {len(axes)}',
            *(f'NAXIS{k}'.ljust(8) + f'= {n}' for k, n in enumerate(axes, 1))]


@pytest.mark.parametrize('name, content, message', [
    ('a.png', png(13_300, 13_300), 'an image of 176.89 megapixels, at most 64 are read '),
    ('a.png', png(2**31 - 1, 2**31 - 1), 'limit|exceeds|megapixels'),
    ('a.png', png(8001, 8000), 'STARCAL_MAX_IMAGE_MPX'),
    ('a.fits', cards('NAXIS   = 99999999999999'), 'NAXIS = 99999999999999, at most 9 are read'),
    ('a.fits', cards(f'NAXIS   = {"9" * 60}'), 'needs a number of pixels or bytes'),
    ('a.fits', cards('NAXIS   = -3'), 'NAXIS = -3, needs 0 or more'),
    ('a.fits', cards('NAXIS   = many'), 'NAXIS = many, needs an integer'),
    ('a.fits', cards(*naxis(99999999999, 2)), 'an image of 200000 megapixels'),
    ('a.fits', cards(*naxis(8000, 8000, 100)), 'an image of 1600 megapixels'),
    ('a.fits', cards(*naxis(100, -100)), 'needs 0 or more'),
    ('a.fits', cards(*naxis(100, 100)), 'damaged'),
    ('a.fits', gzip.compress(bytes(10**7)), 'not FITS: it does not begin with SIMPLE'),
    ('a.fits.gz', gzip.compress(bytes(200_000)), 'an image, unpacked, of '),
    ('a.fits', cards('NAXIS   = 0') + b'XTENSION' + bytes(2872), 'END card'),
    ('a.fits', (b'SIMPLE  =                    T'.ljust(80) + b'COMMENT'.ljust(80) * 35) * 1
     + (b'COMMENT'.ljust(80) * 36) * 1001, 'a header of more than 1000 blocks')],
    ids=range(15))
def test_what_announces_too_much_is_refused_at_once(
        tmp_path, monkeypatch, name, content, message):
    path = tmp_path / name
    if 'unpacked' in message:
        monkeypatch.setenv(IMAGE.variable, '0.005')
    path.write_bytes(content)
    begin = time.perf_counter()
    with pytest.raises(ImageFileError, match=message) as caught:
        load(path)
    assert time.perf_counter() - begin < 5.0
    assert str(caught.value).startswith(f'{path}: ') and '\n' not in str(caught.value)


def test_the_limit_is_the_users(tmp_path, monkeypatch):
    Image.fromarray(STARS).save(tmp_path / 'a.png')
    fits.PrimaryHDU(STARS).writeto(tmp_path / 'a.fits')
    monkeypatch.setenv(IMAGE.variable, '0.005')
    for name in ('a.png', 'a.fits'):
        with pytest.raises(ImageFileError, match='an image of 0.00512 megapixels, at most 0.005'):
            load(tmp_path / name)
    monkeypatch.setenv(IMAGE.variable, '0.006')
    for name in ('a.png', 'a.fits'):
        assert load(tmp_path / name).counts.shape == STARS.shape


@pytest.mark.parametrize('kind', ['pipe', 'folder'])
def test_what_is_no_file_is_refused(tmp_path, kind):
    """A pipe that nobody writes to would never end."""
    path = tmp_path / 'a.png'
    os.mkfifo(path) if kind == 'pipe' else path.mkdir()
    with pytest.raises(ImageFileError, match='no file'):
        load(path)


def compressed(path, kind, tile=(16, 80), counts=STARS):
    """Write a tile-compressed image."""
    unit = fits.CompImageHDU(counts.astype(np.int32), compression_type=kind, tile_shape=tile)
    fits.HDUList([fits.PrimaryHDU(), unit]).writeto(path)
    return path


KINDS = ['GZIP_1', 'GZIP_2', 'RICE_1', 'HCOMPRESS_1', 'PLIO_1']


@pytest.mark.parametrize('kind', KINDS)
def test_a_compressed_image_is_read(tmp_path, kind):
    path = compressed(tmp_path / 'a.fits', kind)
    np.testing.assert_array_equal(load(path).counts, STARS[::-1].astype(np.float32))


@pytest.mark.parametrize('kind', KINDS)
def test_a_damaged_compressed_image_is_an_error_in_one_line_or_an_image(tmp_path, kind):
    whole = compressed(tmp_path / 'a.fits', kind).read_bytes()
    rng, path, errors = np.random.default_rng(3), tmp_path / 'b.fits', 0
    for k in range(12):
        data = np.frombuffer(whole, np.uint8).copy()
        place = rng.integers(2880 if k % 2 else 5760, len(data), 8)
        data[place] = rng.integers(0, 256, 8)
        path.write_bytes(data)
        try:
            load(path)
        except ImageFileError as error:
            errors += 1
            assert str(error).startswith(f'{path}: ') and '\n' not in str(error)
    assert errors


@pytest.mark.parametrize('kind', ['GZIP_1', 'GZIP_2'])
def test_a_tile_that_holds_more_than_its_pixels_is_refused(tmp_path, kind):
    path = compressed(tmp_path / 'a.fits', kind, (64, 80), NOISE)
    bomb = np.frombuffer(gzip.compress(bytes(10_000_000)), np.uint8)
    with fits.open(path, disable_image_compression=True) as units:
        table = units[1]
        assert len(bomb) < len(table.data['COMPRESSED_DATA'][0])
        header, count = table.header.copy(), len(table.data['COMPRESSED_DATA'][0])
    raw = path.read_bytes()
    start = raw.index(b'\x1f\x8b', 5760)
    padded = bomb.tobytes().ljust(count, b'\0')
    path.write_bytes(raw[:start] + padded + raw[start + count:])
    assert header['ZCMPTYPE'] == kind
    with pytest.raises(ImageFileError, match='damaged tile: more than its 5120 pixels'):
        load(path)
