# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""CDR of images against the serializer of `rosbags`, and what can not be used."""

import numpy as np
import pytest
from test_cdr import STORE, TYPES, header

from starcal_ros.messages.cdr import RecordError
from starcal_ros.messages.cdr_image import (IMAGE_TYPE, ImageMessageError, decode_image,
                                            encode_image)

STAMP_NS = 1_782_993_600_250_000_000
PIXELS = np.arange(4 * 5, dtype=np.uint16).reshape(4, 5) * 3001


def message(data, width, height=4, encoding='mono16', step=None, is_bigendian=0, frame_id='lens',
            little_endian=True):
    """Serialize an Image with rosbags."""
    data = np.frombuffer(bytes(data), np.uint8)
    return bytes(STORE.serialize_cdr(TYPES[IMAGE_TYPE](
        header=header(STAMP_NS, frame_id), height=height, width=width, encoding=encoding,
        is_bigendian=is_bigendian, step=len(data) // height if step is None else step, data=data),
        IMAGE_TYPE, little_endian=little_endian))


def padded(pixels, pad=3):
    """Return the bytes of an image whose rows are followed by something else."""
    rows = pixels.reshape(len(pixels), -1)
    return np.pad(rows.view(np.uint8).reshape(len(rows), -1), ((0, 0), (0, pad)),
                  constant_values=255).tobytes()


@pytest.mark.parametrize('frame_id', ['', 'a', 'ab', 'abc', 'star_tracker_optical'])
@pytest.mark.parametrize('shape', [(16, 16), (17, 31)])
def test_what_is_encoded_is_what_rosbags_encodes_and_is_decoded_again(frame_id, shape):
    pixels = np.random.default_rng(1).integers(0, 65536, shape).astype(np.uint16)
    ours = encode_image(STAMP_NS, pixels, frame_id)
    assert ours == message(pixels.astype('<u2').tobytes(), shape[1], shape[0], frame_id=frame_id)
    again = decode_image(ours)
    assert again[:2] == (STAMP_NS, frame_id) and again.pixels.dtype == np.uint16
    np.testing.assert_array_equal(again.pixels, pixels)


@pytest.mark.parametrize('little_endian', [True, False])
@pytest.mark.parametrize('pad', [0, 3])
@pytest.mark.parametrize('encoding, kind, is_bigendian', [
    ('mono8', 'u1', 0), ('8UC1', 'u1', 1), ('mono16', '<u2', 0), ('mono16', '>u2', 1),
    ('16UC1', '<u2', 0), ('16UC1', '>u2', 1)])
def test_grey_of_any_byte_order_and_padding(encoding, kind, is_bigendian, pad, little_endian):
    expected = (PIXELS % 256 if kind == 'u1' else PIXELS).astype(kind)
    read = decode_image(message(padded(expected, pad), 5, encoding=encoding,
                                is_bigendian=is_bigendian, little_endian=little_endian))
    assert read.pixels.dtype == np.dtype(kind).newbyteorder('=')
    np.testing.assert_array_equal(read.pixels, expected)


@pytest.mark.parametrize('encoding, kind, order, channels', [
    ('rgb8', 'u1', [0, 1, 2], 3), ('bgr8', 'u1', [2, 1, 0], 3), ('rgba8', 'u1', [0, 1, 2], 4),
    ('bgra8', 'u1', [2, 1, 0], 4), ('rgb16', '<u2', [0, 1, 2], 3), ('bgr16', '<u2', [2, 1, 0], 3)])
def test_colour_becomes_luminance_and_is_saturated_where_a_channel_is(
        encoding, kind, order, channels):
    full = np.iinfo(kind).max
    rgb = np.array([[[10, 20, 30], [full, 0, 0], [0, 200, 0]]] * 4)
    pixels = np.zeros((4, 3, channels), kind)
    pixels[..., order] = rgb
    read = decode_image(message(padded(pixels), 3, encoding=encoding))
    # 0.299 R + 0.587 G + 0.114 B
    np.testing.assert_array_equal(read.pixels, [[18, full, 117]] * 4)


@pytest.mark.parametrize('pattern', ['rggb', 'bggr', 'grbg', 'gbrg'])
@pytest.mark.parametrize('kind', ['u1', '<u2'])
def test_a_mosaic_is_told_with_its_colours(pattern, kind):
    expected = (PIXELS % 256).astype(kind)
    read = decode_image(message(padded(expected), 5,
                                encoding=f'bayer_{pattern}{8 * np.dtype(kind).itemsize}'))
    np.testing.assert_array_equal(read.pixels, expected)
    assert read.pattern == pattern.upper()


@pytest.mark.parametrize('is_bigendian', [0, 1])
def test_floats_stay_floats(is_bigendian):
    expected = (PIXELS / 7.0).astype('>f4' if is_bigendian else '<f4')
    read = decode_image(message(padded(expected), 5, encoding='32FC1', is_bigendian=is_bigendian))
    np.testing.assert_array_equal(read.pixels, expected)
    assert read.pixels.dtype == np.float32 and read.pattern == ''


def test_padding_of_the_last_row_may_be_missing():
    read = decode_image(message(padded(PIXELS)[:-3], 5, step=13))
    np.testing.assert_array_equal(read.pixels, PIXELS)


@pytest.mark.parametrize('changes, kind, detail', [
    ({'encoding': 'yuv422'}, 'unsupported encoding',
     "'yuv422', supported are mono8, 8UC1, mono16"),
    ({'encoding': ''}, 'unsupported encoding', "''"),
    ({'step': 9}, 'wrong step', '9 bytes a row, 5 pixels mono16 need 10'),
    ({'step': 0}, 'wrong step', '0 bytes a row'),
    ({'height': 5, 'step': 10}, 'wrong length of data', '40 bytes, 5 rows of 10 bytes need 50'),
    ({'height': 2**32 - 1, 'step': 2**32 - 1}, 'wrong length of data', '40 bytes'),
    ({'width': 2**31, 'step': 10}, 'wrong step', '10 bytes a row'),
    ({'height': 0, 'step': 10}, 'empty image', '5 x 0 pixels'),
    ({'width': 0}, 'empty image', '0 x 4 pixels')])
def test_what_contradicts_itself_is_named(changes, kind, detail):
    with pytest.raises(ImageMessageError) as caught:
        decode_image(message(**{'data': PIXELS.tobytes(), 'width': 5, **changes}))
    assert caught.value.kind == kind and str(caught.value).startswith(f'{kind}: ')
    assert detail in str(caught.value) and '\n' not in str(caught.value)


def test_any_part_of_a_message_is_refused_and_not_more():
    """Cut anywhere, it is an error of one kind that everybody who reads messages knows."""
    whole = message(PIXELS.tobytes(), 5)
    for size in range(len(whole)):
        with pytest.raises(ImageMessageError) as caught:
            decode_image(whole[:size])
        assert caught.value.kind == 'damaged message'
    assert issubclass(ImageMessageError, RecordError)


def test_rubbish_is_refused_in_one_line():
    rng = np.random.default_rng(2)
    whole = bytearray(message(PIXELS.tobytes(), 5))
    for _ in range(2000):
        damaged = bytearray(whole)
        for at in rng.integers(0, 70, 4):
            damaged[at] = rng.integers(0, 256)
        try:
            decode_image(bytes(damaged))
        except ImageMessageError as error:
            assert '\n' not in str(error)
