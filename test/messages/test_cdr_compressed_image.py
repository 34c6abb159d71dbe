# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""CompressedImage: as rclpy and rosbags write it, and what is wrong with one."""

from compressed_images import compressed
import numpy as np
import pytest

from starcal_ros.messages.cdr_compressed_image import decode_compressed
from starcal_ros.messages.cdr_image import ImageMessageError

STAMP_NS = 1_700_000_000_123_456_789
RNG = np.random.default_rng(1)
GREY16 = RNG.integers(0, 65536, (40, 60)).astype(np.uint16)
GREY8 = (GREY16 >> 8).astype(np.uint8)
COLOUR = RNG.integers(0, 256, (40, 60, 3)).astype(np.uint8)


@pytest.mark.parametrize('frame_id', ['', 'a', 'star_tracker_optical'])
@pytest.mark.parametrize('pixels, described', [
    (GREY16, 'mono16; png compressed '), (GREY8, 'png'), (GREY8, 'mono8; png compressed mono8')])
def test_png_is_the_image_to_the_bit(pixels, described, frame_id):
    found = decode_compressed(compressed(pixels, 'PNG', described, STAMP_NS, frame_id))
    assert (found.stamp_ns, found.frame_id, found.pattern) == (STAMP_NS, frame_id, '')
    assert found.pixels.dtype == pixels.dtype
    np.testing.assert_array_equal(found.pixels, pixels)


def test_jpeg_is_the_image_to_its_loss():
    smooth = (100.0 + 80.0 * np.sin(np.arange(60) / 9.0) * np.ones((40, 1))).astype(np.uint8)
    found = decode_compressed(compressed(smooth, 'JPEG', 'jpeg', STAMP_NS))
    assert found.pixels.dtype == np.uint8
    assert np.abs(found.pixels.astype(int) - smooth).max() < 12


def test_colour_becomes_luminance():
    found = decode_compressed(compressed(COLOUR, 'PNG', 'rgb8; png compressed bgr8'))
    expected = COLOUR @ [0.299, 0.587, 0.114]
    clean = (COLOUR < 255).all(axis=-1)
    assert np.abs(found.pixels - expected)[clean].max() <= 1.0


def test_a_mosaic_keeps_its_pattern_where_it_is_one():
    assert decode_compressed(compressed(
        GREY8, 'PNG', 'bayer_rggb8; png compressed ')).pattern == 'RGGB'
    assert decode_compressed(compressed(
        COLOUR, 'JPEG', 'bayer_rggb8; jpeg compressed bgr8')).pattern == ''


@pytest.mark.parametrize('spoil, culprit', [
    (lambda message: message[:10], 'cut short'),
    (lambda message: message[:30], 'cut short'),
    (lambda message: message[:-100], 'are announced'),
    (lambda message: b'\0\3' + message[2:], 'not plain CDR'),
    (lambda message: message.replace(b'\x89PNG', b'\x89PNX'), 'no whole JPEG or PNG'),
    (lambda message: message[:200] + bytes(len(message) - 200), 'no whole JPEG or PNG')])
def test_what_is_wrong_is_said(spoil, culprit):
    with pytest.raises(ImageMessageError, match=culprit):
        decode_compressed(spoil(compressed(GREY16, 'PNG', 'mono16; png compressed ')))


def test_depth_is_refused_and_other_formats_are_no_images():
    with pytest.raises(ImageMessageError, match='compressedDepth.*jpeg and png'):
        decode_compressed(compressed(GREY16, 'PNG', '16UC1; compressedDepth png'))
    with pytest.raises(ImageMessageError, match='no whole JPEG or PNG'):
        decode_compressed(compressed(GREY8, 'TIFF', 'tiff'))


def test_a_bomb_is_not_unpacked(monkeypatch):
    monkeypatch.setenv('STARCAL_MAX_IMAGE_MPX', '0.001')
    with pytest.raises(ImageMessageError, match='too large'):
        decode_compressed(compressed(GREY16, 'PNG', 'png'))
