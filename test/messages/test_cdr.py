# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""CDR of gyro samples and star frames against the serializer of `rosbags`."""

from dataclasses import replace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.messages import cdr_pointcloud
from starcal_ros.messages.cdr import Messages, RecordError, frame_id
from starcal_ros.messages.cdr_imu import IMU_TYPE, _decode_any, decode_imu, encode_imu
from starcal_ros.messages.cdr_pointcloud import (CLOUD_TYPE, decode_centroids, encode_centroids,
                                                 with_catalog_ids)

STORE = get_typestore(Stores.ROS2_KILTED)
TYPES = STORE.types
DATATYPES = {'i1': 1, 'u1': 2, 'i2': 3, 'u2': 4, 'i4': 5, 'u4': 6, 'f4': 7, 'f8': 8}
GYRO = GyroSamples(np.array([1_782_993_600_010_000_000, -1, 0, 4_294_967_295_999_999_999 // 2]),
                   np.array([[1e-3, -2e-3, 3e-3], [0, 0, 0], [np.nan, np.inf, -np.inf],
                             [1, 2, 3]]))
FRAMES = Frames(
    np.array([1_782_993_600_250_000_000, 1_782_993_600_750_000_000, 1_782_993_601_250_000_000]),
    np.array([0, 2, 2, 5]), np.array([[0.5, 1.25], [2047, 0], [3, 4], [np.nan, 5], [6, 7]]),
    np.array([0.03125, 0.0625, 0, 1, 2]), np.array([2.5, np.nan, 3, 4, 5]),
    np.array([11767, 0, 118322, 1, 2]))


def header(stamp_ns, frame_id):
    """Make a std_msgs/Header of rosbags."""
    sec, nanosec = divmod(int(stamp_ns), 10**9)
    return TYPES['std_msgs/msg/Header'](
        stamp=TYPES['builtin_interfaces/msg/Time'](sec=sec, nanosec=nanosec), frame_id=frame_id)


def imu(stamp_ns, rate, frame_id='gyro', variance=0.0, little_endian=True):
    """Serialize one Imu with rosbags."""
    vector, unknown = TYPES['geometry_msgs/msg/Vector3'], np.array([-1.0] + 8 * [0.0])
    return bytes(STORE.serialize_cdr(TYPES[IMU_TYPE](
        header=header(stamp_ns, frame_id),
        orientation=TYPES['geometry_msgs/msg/Quaternion'](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=unknown, angular_velocity=vector(*map(float, rate)),
        angular_velocity_covariance=np.diag(3 * [variance]).ravel(),
        linear_acceleration=vector(x=0.0, y=0.0, z=0.0),
        linear_acceleration_covariance=unknown), IMU_TYPE, little_endian=little_endian))


def cloud(points, frame_id='star_tracker_optical', stamp_ns=10**9, rows=1, pad=0, order='<',
          little_endian=True, pad_last=True, **changes):
    """Serialize a PointCloud2 with rosbags from a structured array; `pad` lengthens each row."""
    points = points.astype(points.dtype.newbyteorder(order))
    point_step = points.dtype.itemsize
    width = len(points) // rows
    data = points.view(np.uint8).reshape(rows, width * point_step)
    data = np.pad(data, ((0, 0), (0, pad)), constant_values=255).ravel()
    field = TYPES['sensor_msgs/msg/PointField']
    content = {
        'header': header(stamp_ns, frame_id), 'height': rows, 'width': width,
        'fields': [field(name=name, offset=offset, datatype=DATATYPES[dtype.str[1:]], count=1)
                   for name, (dtype, offset) in points.dtype.fields.items()],
        'is_bigendian': order == '>', 'point_step': point_step,
        'row_step': width * point_step + pad, 'is_dense': True,
        'data': data if pad_last else data[:len(data) - pad]}
    return bytes(STORE.serialize_cdr(TYPES[CLOUD_TYPE](**{**content, **changes}), CLOUD_TYPE,
                                     little_endian=little_endian))


def points_of(frames, dtype):
    """Put stars into a structured array."""
    points = np.zeros(len(frames.uv_raster), dtype)
    columns = {'u': frames.uv_raster[:, 0], 'v': frames.uv_raster[:, 1], 'sigma': frames.sigma,
               'magnitude': frames.magnitude, 'catalog_id': frames.catalog_id}
    for name in set(columns) & set(points.dtype.names):
        points[name] = columns[name]
    return points


def assert_same(one, other):
    """Compare samples or frames, NaN equal to NaN."""
    for name in vars(one):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@pytest.mark.parametrize('frame_id', ['', 'g', 'gyro', 'gyro_1', 'a_longer_name', 'kreisel_ä'])
def test_encoded_imu_is_what_rosbags_writes(frame_id):
    rows = encode_imu(GYRO, frame_id, 1e-8)
    expected = [imu(stamp, rate, frame_id, 1e-8) for stamp, rate in zip(GYRO.stamp_ns, GYRO.rate)]
    assert [row.tobytes() for row in rows] == expected


def test_imu_of_any_frame_id_and_byte_order_is_decoded_in_one_batch():
    ids, n = ['', 'gyro', 'imu_link', 'a/b/c/d/e'], 40
    rng = np.random.default_rng(3)
    gyro = GyroSamples(10**18 + np.arange(n) * 10**7, rng.normal(size=(n, 3)))
    messages = [imu(stamp, rate, ids[k % 4], little_endian=bool(k % 3))
                for k, (stamp, rate) in enumerate(zip(gyro.stamp_ns, gyro.rate))]
    assert_same(decode_imu(Messages.join(messages)), gyro)


def test_gyro_samples_survive_a_round_trip_with_all_that_is_not_finite():
    assert_same(decode_imu(Messages.join([row.tobytes() for row in encode_imu(GYRO)])), GYRO)


@pytest.mark.parametrize('little_endian', [False, True])
@pytest.mark.parametrize('frame_id', ['', 'gyro', 'kreisel_ä'])
def test_imu_of_one_layout_is_decoded_as_that_of_any(frame_id, little_endian):
    messages = Messages.join([imu(stamp, rate, frame_id, little_endian=little_endian)
                              for stamp, rate in zip(GYRO.stamp_ns, GYRO.rate)])
    assert_same(decode_imu(messages), GYRO)
    assert_same(_decode_any(messages), GYRO)


def test_nothing_decodes_to_nothing():
    assert len(decode_imu(Messages.join([]))) == len(decode_centroids(Messages.join([]))) == 0
    assert encode_imu(GyroSamples.empty()).shape[0] == len(encode_centroids(Frames.empty())) == 0


@pytest.mark.parametrize('size', [0, 3, 4, 12, 16, 100, 323])
def test_a_cut_imu_is_an_error_that_gives_its_size(size):
    whole = imu(0, (1, 2, 3))
    with pytest.raises(RecordError, match=f'a message of {size} bytes is cut short'):
        decode_imu(Messages.join([whole, whole[:size]]))


def test_an_imu_with_a_garbled_frame_id_length_is_an_error():
    whole = bytearray(imu(0, (1, 2, 3)))
    whole[12:16] = b'\xff\xff\xff\xff'
    with pytest.raises(RecordError, match='cut short: sensor_msgs/msg/Imu needs'):
        decode_imu(Messages.join([bytes(whole)]))


def test_another_encapsulation_is_an_error_that_names_it():
    with pytest.raises(RecordError, match='0x0003 is not plain CDR'):
        decode_imu(Messages.join([b'\0\3' + imu(0, (1, 2, 3))[2:]]))


def test_encoded_centroids_are_what_rosbags_writes():
    dtype = [('u', '<f8'), ('v', '<f8'), ('sigma', '<f4'), ('magnitude', '<f4'),
             ('catalog_id', '<u4')]
    expected = [cloud(points_of(FRAMES[k:k + 1], dtype), stamp_ns=FRAMES.stamp_ns[k])
                for k in range(len(FRAMES))]
    assert encode_centroids(FRAMES) == expected


def test_star_frames_survive_a_round_trip_with_all_that_is_not_finite():
    assert_same(decode_centroids(Messages.join(encode_centroids(FRAMES))), FRAMES)


SHUFFLED = {'names': ['catalog_id', 'v', 'flux', 'u', 'magnitude', 'sigma'],
            'formats': ['i4', 'f8', 'f4', 'f8', 'f8', 'f4'],
            'offsets': [1, 8, 44, 21, 33, 16], 'itemsize': 53}


@pytest.mark.parametrize('order', '<>')
@pytest.mark.parametrize('little_endian', [True, False])
def test_fields_are_found_by_name_in_any_order_type_and_byte_order(order, little_endian):
    messages = [cloud(points_of(FRAMES[k:k + 1], SHUFFLED), stamp_ns=FRAMES.stamp_ns[k],
                      order=order, little_endian=little_endian) for k in range(len(FRAMES))]
    assert_same(decode_centroids(Messages.join(messages)), FRAMES)


@pytest.mark.parametrize('kind', DATATYPES)
def test_every_numeric_datatype_is_read(kind):
    values = np.zeros(3, [(name, kind) for name in ('u', 'v', 'sigma', 'magnitude', 'catalog_id')])
    for name in values.dtype.names:
        values[name] = [0, 7, 101]
    frames = decode_centroids(Messages.join([cloud(values)]))
    for column in (*frames.uv_raster.T, frames.sigma, frames.magnitude, frames.catalog_id):
        np.testing.assert_array_equal(column, [0, 7, 101])


def test_missing_fields_mean_unknown():
    points = points_of(FRAMES, [('u', 'f4'), ('v', 'f4')])
    frames = decode_centroids(Messages.join([cloud(points)]))
    assert not frames.sigma.any() and not frames.catalog_id.any()
    assert np.isnan(frames.magnitude).all()


def test_a_catalogue_number_that_is_not_finite_means_not_identified():
    points = np.array([(1, 2, np.nan), (3, 4, 5)],
                      [('u', 'f8'), ('v', 'f8'), ('catalog_id', 'f4')])
    np.testing.assert_array_equal(
        decode_centroids(Messages.join([cloud(points)])).catalog_id, [0, 5])


def test_layouts_may_change_from_message_to_message():
    plain = [('u', 'f8'), ('v', 'f8'), ('sigma', 'f4'), ('magnitude', 'f4'), ('catalog_id', 'u4')]
    messages = [cloud(points_of(FRAMES[k % 3:k % 3 + 1], (plain, SHUFFLED)[k % 2]),
                      frame_id='o' * (k % 5), stamp_ns=FRAMES.stamp_ns[k % 3],
                      order='<>'[k % 4 == 3], little_endian=k % 7 != 0) for k in range(30)]
    assert_same(decode_centroids(Messages.join(messages)), Frames.concatenate(10 * [FRAMES]))


def test_padding_that_differs_in_every_message_makes_no_new_layout(monkeypatch):
    parsed, parse = [], cdr_pointcloud._parse_layout

    def spy(*args):
        parsed.append(args)
        return parse(*args)

    monkeypatch.setattr(cdr_pointcloud, '_parse_layout', spy)
    messages = []
    for k, message in enumerate(encode_centroids(FRAMES) * 50):
        dirty = bytearray(message)
        name = dirty.index(b'u\0')
        dirty[name + 2:name + 4] = dirty[name + 9:name + 11] = k.to_bytes(2, 'little')
        messages.append(bytes(dirty))
    assert_same(decode_centroids(Messages.join(messages)), Frames.concatenate(50 * [FRAMES]))
    assert len(parsed) == 1


@pytest.mark.parametrize('pad', [0, 5])
@pytest.mark.parametrize('pad_last', [True, False])
def test_clouds_of_several_padded_rows_are_read_row_by_row(pad, pad_last):
    points = np.zeros(6, [('u', 'f8'), ('v', 'f8')])
    points['u'], points['v'] = np.arange(6), np.arange(6) + 10
    frames = decode_centroids(Messages.join(
        [cloud(points, rows=rows, pad=pad, pad_last=pad_last) for rows in (2, 1, 3)]))
    np.testing.assert_array_equal(frames.uv_raster,
                                  np.tile(np.arange(6)[:, None] + [0, 10], (3, 1)))


def test_a_cloud_without_u_is_an_error_that_lists_its_fields():
    points = np.zeros(2, [('x', 'f4'), ('v', 'f8')])
    with pytest.raises(RecordError, match=f"no field 'u' in a {CLOUD_TYPE}; it has x, v"):
        decode_centroids(Messages.join([cloud(points)]))


def test_an_empty_cloud_needs_no_fields():
    empty = cloud(np.zeros(0, [('u', 'f8')]), fields=[], point_step=0)
    assert decode_centroids(Messages.join([empty])).star_counts.tolist() == [0]


@pytest.mark.parametrize('changes, message', [
    ({'width': 3}, '1 rows of 3 points of 16 bytes'),
    ({'width': 2**32 - 1, 'height': 2**32 - 1}, 'do not fit into 32 bytes'),
    ({'height': 2, 'row_step': 0, 'width': 1}, 'row_step 0'),
    ({'point_step': 8}, "'v' at offset 8 does not fit into a point of 8 bytes"),
    ({'point_step': 2**32 - 1}, 'a point_step of 4294967295 bytes'),
])
def test_a_cloud_that_contradicts_itself_is_an_error(changes, message):
    points = np.zeros(2, [('u', 'f8'), ('v', 'f8')])
    with pytest.raises(RecordError, match=message):
        decode_centroids(Messages.join([cloud(points, **changes)]))


def test_an_unknown_datatype_is_an_error_that_names_the_field():
    field = TYPES['sensor_msgs/msg/PointField'](name='u', offset=0, datatype=77, count=1)
    with pytest.raises(RecordError, match="the field 'u' has datatype 77"):
        decode_centroids(Messages.join([cloud(np.zeros(1, [('u', 'f8')]), fields=[field])]))


def test_a_cloud_cut_anywhere_is_an_error_never_a_wrong_frame():
    whole = cloud(points_of(FRAMES[:1], SHUFFLED))
    for size in range(len(whole) - 1):      # the last byte, is_dense, is not read
        with pytest.raises(RecordError):
            decode_centroids(Messages.join([whole[:size]]))


def test_random_bytes_are_an_error_or_a_frame_never_another_exception():
    rng = np.random.default_rng(11)
    whole = np.frombuffer(cloud(points_of(FRAMES[:1], SHUFFLED)), np.uint8)
    for _ in range(3000):
        broken = whole.copy()
        broken[rng.integers(4, len(whole), 3)] = rng.integers(0, 256, 3)
        try:
            decode_centroids(Messages.join([broken.tobytes()]))
        except RecordError:
            pass


# Numbers put into a cloud

NUMBERED = np.array([0, 118322, 7, 91262, 1, 65536])
DRIVER = np.dtype([('v', 'f4'), ('peak', 'u2'), ('u', 'f8'), ('catalog_id', 'u4'), ('x', 'i1')])


@pytest.mark.parametrize('little_endian', [True, False])
@pytest.mark.parametrize('order', ['<', '>'])
@pytest.mark.parametrize('rows, pad, pad_last', [(1, 0, True), (2, 5, True), (3, 2, False)])
@pytest.mark.parametrize('id_type', ['u4', 'i4', 'f4', 'f8', None])
def test_numbers_change_and_all_else_stays(order, rows, pad, pad_last, id_type, little_endian):
    fields = [(name, id_type if name == 'catalog_id' else kind.str[1:])
              for name, (kind, _) in DRIVER.fields.items()]
    points = np.zeros(6, [field for field in fields if field[1]])
    for k, name in enumerate(points.dtype.names):
        points[name] = np.arange(6) + 10 * k
    message = cloud(points, 'lens', 5 * 10**9 + 7, rows, pad, order, little_endian, pad_last)
    given = Messages.join([message])
    changed = Messages.join([with_catalog_ids(message, NUMBERED)])
    before, after = decode_centroids(given), decode_centroids(changed)
    assert_same(replace(before, catalog_id=NUMBERED), after)
    read, original = (STORE.deserialize_cdr(m.data.tobytes(), CLOUD_TYPE)
                      for m in (changed, given))
    assert read.header == original.header and read.is_bigendian == original.is_bigendian
    assert (read.height, read.width, read.is_dense) == (rows, 6 // rows, True)
    assert [field.name for field in read.fields] == [
        *(field.name for field in original.fields), *([] if id_type else ['catalog_id'])]
    for field, old in zip(read.fields, original.fields):
        assert field == old
    for row, old in zip(range(rows), range(rows)):
        for column in range(6 // rows):
            at = row * read.row_step + column * read.point_step
            was = old * original.row_step + column * original.point_step
            for name in ('peak', 'x'):
                offset = points.dtype.fields[name][1]
                size = points.dtype[name].itemsize
                assert (read.data[at + offset:at + offset + size].tobytes()
                        == original.data[was + offset:was + offset + size].tobytes())


def test_a_frame_without_stars_goes_through_as_it_is():
    message, = encode_centroids(FRAMES[1:2])
    assert with_catalog_ids(message, np.empty(0, np.int64)) == message


def test_a_field_that_can_not_hold_a_number_is_an_error():
    points = np.zeros(2, [('u', 'f8'), ('v', 'f8'), ('catalog_id', 'u2')])
    with pytest.raises(RecordError, match="'catalog_id' of a .* is uint16, too small"):
        with_catalog_ids(cloud(points), np.array([1, 2]))


@pytest.mark.parametrize('name', ['gyro', '', 'ein_längerer_Name', '\x1b[2J'])
@pytest.mark.parametrize('little_endian', [True, False])
def test_frame_id_of_a_message_is_read_and_shown_as_it_stands(name, little_endian):
    message = bytes(imu(1, np.zeros(3), name, little_endian=little_endian))
    assert frame_id(message) == name.replace('\x1b', '\\x1b')
    for cut in (0, 3, 15, 16):
        assert frame_id(message[:cut]) is None
    assert frame_id(message[:12] + b'\xff' * 4 + message[16:]) is None
