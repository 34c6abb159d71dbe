# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings written, read by others, and read back."""

import hashlib
import shutil

from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
import mcap.writer
import numpy as np
import pytest
from rosbags import rosbag2
import yaml

from instruments import EXTERNAL
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.messages.cdr_imu import IMU_TYPE, encode_imu
from starcal_ros.messages.cdr_pointcloud import CLOUD_TYPE, encode_centroids
from starcal_ros.recording.qos import LATCHED, Qos
from starcal_ros.recording.reader import FRAMES_TOPIC, GYRO_TOPIC, RecordError, read, summary
from starcal_ros.recording.topic_choice import TopicChoice
from starcal_ros.recording.writer import (Batch, Writer, centroids_batch, imu_batch, serialize,
                                          typestore)
from written import (FRAMES, GYRO, START_NS, assert_holds_all, assert_same, messages, sensors,
                     split, write, write_with_mcap, write_with_rosbags)


def test_what_is_written_is_read_back(tmp_path):
    path = write(tmp_path / 'run.mcap')
    recording = read(path)
    assert_holds_all(recording)
    assert recording.attachments == {'config.yaml': b'a: 1\n', 'truth.json': b'{}'}
    assert (recording.gyro_topic, recording.frames_topic) == (GYRO_TOPIC, FRAMES_TOPIC)
    assert recording.path == path
    assert recording.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_external_recording_is_read():
    if not EXTERNAL.exists():
        pytest.skip('the external recording lies beside the checkout, and is not there')
    recording = read(EXTERNAL)
    assert (len(recording.gyro), len(recording.frames)) == (30_000, 598)
    assert np.isfinite(recording.gyro.rate).all() and np.isfinite(recording.frames.uv_raster).all()
    assert (recording.frames.catalog_id > 0).all() and not recording.warnings
    assert_same(read(EXTERNAL / 'external_tan2018.mcap').gyro, recording.gyro)


def test_the_library_of_mcap_reads_every_message_in_order(tmp_path):
    with write(tmp_path / 'run.mcap').open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [(channel.topic, schema.name, message.log_time, message.data) for
                 schema, channel, message in reader.iter_messages(log_time_order=False)]
        assert sorted(found) == sorted(messages())
        assert [row[2] for row in found] == sorted(row[2] for row in found)
        assert {a.name: a.data for a in reader.iter_attachments()} == {
            'config.yaml': b'a: 1\n', 'truth.json': b'{}'}
        statistics = reader.get_summary().statistics
        assert statistics.message_count == len(GYRO) + len(FRAMES)
        assert statistics.chunk_count == len(reader.get_summary().chunk_indexes)
        header = reader.get_header()
        assert header.profile == 'ros2' and header.library.startswith('starcal_ros ')


def test_messages_are_numbered_topic_by_topic(tmp_path):
    with write(tmp_path / 'run.mcap').open('rb') as stream:
        found = [(channel.topic, message.sequence)
                 for _, channel, message in make_reader(stream).iter_messages()]
    assert [n for topic, n in found if topic == GYRO_TOPIC] == list(range(len(GYRO)))
    assert [n for topic, n in found if topic == FRAMES_TOPIC] == list(range(len(FRAMES)))


def test_every_checksum_and_the_summary_offsets_are_right(tmp_path):
    with write(tmp_path / 'run.mcap').open('rb') as stream:
        records = list(StreamReader(stream, validate_crcs=True, emit_chunks=False).records)
    offsets = [record for record in records if type(record).__name__ == 'SummaryOffset']
    assert [record.group_opcode for record in offsets] == [3, 4, 0x0B, 8, 0x0A, 0x0D]


def test_rosbags_reads_what_is_written(tmp_path):
    with rosbag2.Reader(write(tmp_path / 'run.mcap')) as bag:
        found = [(c.topic, c.msgtype, t, bytes(data)) for c, t, data in bag.messages()]
        assert sorted(found) == sorted(messages())
        first = typestore().deserialize_cdr(found[0][3], found[0][1])
        assert first.angular_velocity.x == GYRO.rate[0, 0]
        for connection in bag.connections:
            qos, = connection.ext.offered_qos_profiles
            assert (qos.reliability.name, qos.durability.name, qos.history.name, qos.depth) == (
                'RELIABLE', 'VOLATILE', 'KEEP_LAST', 100)
            assert connection.msgdef.data == typestore().generate_msgdef(
                connection.msgtype, ros_version=2)[0]


def test_channels_carry_what_rosbag2_records(tmp_path):
    with Writer(tmp_path / 'run.mcap') as writer:
        writer.write(GYRO_TOPIC, IMU_TYPE, encode_imu(GYRO[:1])[0].tobytes(), START_NS,
                     qos=Qos(depth=7, reliability='best_effort'))
    with (tmp_path / 'run.mcap').open('rb') as stream:
        channel, = make_reader(stream).get_summary().channels.values()
    endless = {'sec': 9223372036, 'nsec': 854775807}
    assert yaml.safe_load(channel.metadata['offered_qos_profiles']) == [{
        'history': 'keep_last', 'depth': 7, 'reliability': 'best_effort',
        'durability': 'volatile', 'deadline': endless, 'lifespan': endless,
        'liveliness': 'automatic', 'liveliness_lease_duration': endless,
        'avoid_ros_namespace_conventions': False}]
    assert channel.metadata['topic_type_hash'] == typestore().hash_rihs01(IMU_TYPE)


def test_a_chunk_holds_no_more_than_a_second_or_its_bytes(tmp_path):
    with Writer(tmp_path / 'run.mcap') as writer:
        writer.write_imu(GYRO_TOPIC, GYRO)
        for k in range(40):
            writer.write('/big', 'std_msgs/msg/UInt8MultiArray', bytes(100_000), START_NS + k)
    with (tmp_path / 'run.mcap').open('rb') as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    assert len(chunks) >= 10 + 4
    assert all(c.message_end_time - c.message_start_time < 10**9 for c in chunks)
    assert all(c.uncompressed_size < 2**20 + 110_000 for c in chunks)


def test_slices_and_single_messages_make_the_same_recording_as_one_call(tmp_path):
    with Writer(tmp_path / 'slices.mcap') as writer:
        for k in range(0, len(GYRO), 130):
            low, high = START_NS + k * 10**7, START_NS + (k + 130) * 10**7
            rows = np.flatnonzero((FRAMES.stamp_ns > low) & (FRAMES.stamp_ns <= high))
            writer.write_batches(centroids_batch(FRAMES_TOPIC, FRAMES[rows[0]:rows[-1] + 1]),
                                 imu_batch(GYRO_TOPIC, GYRO[k:k + 130]))
    with Writer(tmp_path / 'single.mcap') as writer:
        for topic, type_name, log_time, data in messages():
            writer.write(topic, type_name, data, log_time)
    for name in ('slices.mcap', 'single.mcap'):
        assert_holds_all(read(tmp_path / name))


def test_a_low_rate_message_is_serialized_and_latched(tmp_path):
    value = typestore().types['std_msgs/msg/String'](data='hello')
    with Writer(tmp_path / 'run.mcap') as writer:
        writer.write('/note', 'std_msgs/msg/String', serialize('std_msgs/msg/String', value),
                     START_NS, qos=LATCHED)
    row, = summary(tmp_path / 'run.mcap').topics
    assert row.qos == 'reliable, transient_local, keep_last 1'
    with rosbag2.Reader(tmp_path / 'run.mcap') as bag:
        (_, _, data), = bag.messages()
    assert typestore().deserialize_cdr(data, 'std_msgs/msg/String') == value


def test_an_existing_file_is_only_replaced_when_told(tmp_path):
    path = write(tmp_path / 'run.mcap')
    before = path.read_bytes()
    with pytest.raises(RecordError, match='exists; choose another name or overwrite it'):
        Writer(path)
    assert path.read_bytes() == before
    with Writer(path, overwrite=True):
        pass
    assert summary(path).topics == ()


def test_a_file_that_can_not_be_made_is_an_error(tmp_path):
    with pytest.raises(RecordError, match='cannot be written: No such file or directory'):
        Writer(tmp_path / 'nowhere' / 'run.mcap')


def test_close_may_be_called_twice(tmp_path):
    writer = Writer(tmp_path / 'run.mcap')
    writer.write_imu(GYRO_TOPIC, GYRO)
    writer.close()
    size = (tmp_path / 'run.mcap').stat().st_size
    writer.close()
    assert (tmp_path / 'run.mcap').stat().st_size == size


def test_a_topic_keeps_its_type_and_an_unknown_type_is_refused(tmp_path):
    with Writer(tmp_path / 'run.mcap') as writer:
        writer.write('/a', 'std_msgs/msg/Empty', b'\0\1\0\0\0', START_NS)
        with pytest.raises(RecordError, match='/a is of type std_msgs/msg/Empty, not std_msgs/ms'):
            writer.write('/a', 'std_msgs/msg/Bool', b'\0\1\0\0\0', START_NS)
        with pytest.raises(RecordError, match="'my_msgs/msg/Own' is not a message of ROS 2"):
            writer.write('/b', 'my_msgs/msg/Own', b'\0\1\0\0', START_NS)


def test_a_process_killed_while_recording_loses_less_than_the_last_second(tmp_path):
    writer = Writer(tmp_path / 'run.mcap')
    writer.write_batches(imu_batch(GYRO_TOPIC, GYRO), centroids_batch(FRAMES_TOPIC, FRAMES))
    shutil.copy(tmp_path / 'run.mcap', tmp_path / 'killed.mcap')
    writer.close()
    recording = read(tmp_path / 'killed.mcap')
    kept = len(recording.gyro)
    assert kept >= len(GYRO) - 100
    assert_same(recording.gyro, GYRO[:kept])
    warning, = recording.warnings
    assert 'killed.mcap: the file breaks off at byte' in warning


def test_flush_puts_everything_into_the_file(tmp_path):
    writer = Writer(tmp_path / 'run.mcap')
    writer.write_batches(imu_batch(GYRO_TOPIC, GYRO), centroids_batch(FRAMES_TOPIC, FRAMES))
    writer.flush()
    recording = read(tmp_path / 'run.mcap')
    writer.close()
    assert_same(recording.gyro, GYRO)


@pytest.mark.parametrize('options', [
    {}, {'compression': mcap.writer.CompressionType.LZ4, 'chunk_size': 20_000},
    {'compression': mcap.writer.CompressionType.NONE}, {'use_chunking': False},
    {'index_types': mcap.writer.IndexType.NONE, 'chunk_size': 50_000},
    {'repeat_channels': False, 'repeat_schemas': False}, {'enable_crcs': False},
    {'use_statistics': False, 'use_summary_offsets': False, 'repeat_channels': False,
     'repeat_schemas': False, 'index_types': mcap.writer.IndexType.NONE},
], ids=str)
def test_every_kind_of_mcap_is_read(tmp_path, options):
    assert_holds_all(read(write_with_mcap(tmp_path / 'run.mcap', messages(), **options)))


def test_messages_come_in_the_order_of_recording_not_of_the_file(tmp_path):
    rows = messages()
    shuffled = [rows[k] for k in np.random.default_rng(2).permutation(len(rows))]
    assert_holds_all(read(write_with_mcap(tmp_path / 'run.mcap', shuffled, chunk_size=30_000)))


def test_messages_of_equal_log_time_keep_the_order_of_the_file(tmp_path):
    rows = [(topic, kind, START_NS + k // 400, data)
            for k, (topic, kind, _, data) in enumerate(messages())]
    assert_holds_all(read(write_with_mcap(tmp_path / 'run.mcap', rows, chunk_size=30_000)))


def test_a_stamp_may_go_backward_and_a_number_may_be_infinite(tmp_path):
    gyro = GyroSamples(GYRO.stamp_ns[::-1], np.where(GYRO.rate > 1, np.inf, GYRO.rate))
    rows = [(GYRO_TOPIC, IMU_TYPE, START_NS + k, row.tobytes())
            for k, row in enumerate(encode_imu(gyro))]
    rows += [row for row in messages() if row[0] == FRAMES_TOPIC]
    assert_same(read(write_with_mcap(tmp_path / 'run.mcap', rows)).gyro, gyro)


@pytest.mark.parametrize('storage', rosbag2.StoragePlugin)
def test_a_rosbag2_directory_is_read(tmp_path, storage):
    recording = read(write_with_rosbags(tmp_path / 'bag', messages(), storage_plugin=storage))
    assert_holds_all(recording)
    assert len(recording.sha256) == 64


@pytest.mark.parametrize('storage, mode', [
    (rosbag2.StoragePlugin.SQLITE3, rosbag2.CompressionMode.FILE),
    (rosbag2.StoragePlugin.SQLITE3, rosbag2.CompressionMode.MESSAGE),
    (rosbag2.StoragePlugin.MCAP, rosbag2.CompressionMode.FILE),
    (rosbag2.StoragePlugin.MCAP, rosbag2.CompressionMode.STORAGE)])
def test_a_compressed_rosbag2_directory_is_read(tmp_path, storage, mode):
    path = write_with_rosbags(
        tmp_path / 'bag', messages(), storage_plugin=storage,
        prepare=lambda bag: bag.set_compression(mode, rosbag2.CompressionFormat.ZSTD))
    assert_holds_all(read(path))
    assert [row.count for row in summary(path).topics] == [len(GYRO), len(FRAMES)]


def test_a_split_bag_is_read_in_the_order_of_recording(tmp_path):
    path = split(tmp_path / 'bag')
    assert_holds_all(read(path))
    contents = [(path / name).read_bytes() for name in ('a.mcap', 'b.mcap', 'c.mcap')]
    assert read(path).sha256 == hashlib.sha256(b''.join(contents)).hexdigest()


def test_a_split_bag_with_its_files_in_disorder_is_read_in_the_order_of_recording(tmp_path):
    path = split(tmp_path / 'bag')
    text = (path / 'metadata.yaml').read_text()
    swapped = text.replace('a.mcap', 'x').replace('c.mcap', 'a.mcap').replace('x', 'c.mcap')
    (path / 'metadata.yaml').write_text(swapped)
    assert_holds_all(read(path))


def test_progress_grows_to_one(tmp_path):
    done = []
    read(split(tmp_path / 'bag'), done.append)
    assert done == sorted(done) and done[-1] == 1.0 and 0 <= done[0] <= 1


def test_a_namespace_before_the_topics_is_found(tmp_path):
    recording = read(write(tmp_path / 'run.mcap', gyro_topic='/sat1' + GYRO_TOPIC,
                           frames_topic='/sat1' + FRAMES_TOPIC))
    assert recording.gyro_topic == '/sat1/imu/data_raw'
    assert_holds_all(recording)


def test_the_exact_topic_wins_over_one_in_a_namespace(tmp_path):
    with Writer(tmp_path / 'run.mcap') as writer:
        writer.write_batches(imu_batch(GYRO_TOPIC, GYRO), centroids_batch(FRAMES_TOPIC, FRAMES),
                             imu_batch('/other' + GYRO_TOPIC, GYRO[:10]))
    assert_holds_all(read(tmp_path / 'run.mcap'))


def test_sensors_of_other_names_are_found_by_their_types_and_named(tmp_path):
    path = tmp_path / 'run.mcap'
    with Writer(path) as writer:
        writer.write_batches(imu_batch('/gyro', GYRO), centroids_batch('/camera/stars', FRAMES),
                             imu_batch('/sat1/starcal/imu', GYRO[:10]),
                             centroids_batch('/truth/centroids', FRAMES))
    recording = read(path)
    assert_holds_all(recording, ('/gyro is taken for /imu/data_raw',
                                 '/camera/stars is taken for /star_tracker/centroids'))


def test_two_namespaces_are_ambiguous(tmp_path):
    with Writer(tmp_path / 'run.mcap') as writer:
        writer.write_imu('/a/imu/data_raw', GYRO)
        writer.write_imu('/b/imu/data_raw', GYRO)
    with pytest.raises(RecordError,
                       match=r'several topics /imu/data_raw: /a/imu/data_raw \(sensor_msgs/msg/'
                             r'Imu, 1000 messages, 100.00 Hz\), /b/imu/data_raw .*; --gyro-topic'):
        read(tmp_path / 'run.mcap')


def two_of_each(path, storage=None):
    """Write a gyro and an accelerometer, and the stars of two cameras."""
    other = sensors(seed=2)
    rows = [(name, kind, t, data) for topic, kind, t, data in messages()
            for name in ({GYRO_TOPIC: ['/d435/gyro', '/d435/accel'],
                          FRAMES_TOPIC: ['/left/stars', '/right/stars']}[topic])]
    rows += [('/right/stars', CLOUD_TYPE, t, data) for t, data in zip(
        other[1].stamp_ns.tolist(), encode_centroids(other[1]))]
    if storage is None:
        return write_with_mcap(path / 'run.mcap', rows)
    return write_with_rosbags(path / 'bag', rows, storage_plugin=storage)


@pytest.mark.parametrize('storage', [None, *rosbag2.StoragePlugin])
def test_a_choice_is_asked_for_with_type_count_and_rate_and_followed(tmp_path, storage):
    path = two_of_each(tmp_path, storage)
    with pytest.raises(RecordError, match=r'several topics /imu/data_raw: /d435/accel \(sensor_'
                       r'msgs/msg/Imu, 1000 messages, 100.00 Hz\), /d435/gyro .*; --gyro-topic'):
        read(path)
    with pytest.raises(RecordError, match=r'/left/stars \(sensor_msgs/msg/PointCloud2, 20 mess'
                       r'ages, 2.00 Hz\), /right/stars \(.*, 40 messages, .*--frames-topic'):
        read(path, choice=TopicChoice('/d435/gyro'))
    recording = read(path, choice=TopicChoice('d435/gyro', '/left/stars'))
    assert_holds_all(recording)
    assert (recording.gyro_topic, recording.frames_topic) == ('/d435/gyro', '/left/stars')
    assert len(read(path, choice=TopicChoice('/d435/gyro', '/right/stars')).frames) == 40


@pytest.mark.parametrize('choice, said', [
    (TopicChoice('/imu'), 'has no topic /imu; for --gyro-topic it has /d435/accel (sensor_msgs/'),
    (TopicChoice('/left/stars'), '/left/stars is of type sensor_msgs/msg/PointCloud2, not'),
    (TopicChoice('/d435/gyro', '/stars'), 'has no topic /stars; for --frames-topic it has /left'),
    (TopicChoice('/d435/gyro', images='/x'), 'has no topic /x; it has /d435/accel, /d435/gyro, ')])
def test_a_choice_that_is_not_there_is_named_with_what_is(tmp_path, choice, said):
    with pytest.raises(RecordError) as error:
        read(two_of_each(tmp_path), measure=lambda messages: FRAMES, choice=choice)
    assert said in str(error.value)


def test_a_topic_that_is_found_beside_others_is_said(tmp_path):
    with Writer(tmp_path / 'run.mcap') as writer:
        writer.write_batches(imu_batch('/sat' + GYRO_TOPIC, GYRO), imu_batch('/accel', GYRO[:10]),
                             centroids_batch(FRAMES_TOPIC, FRAMES))
    assert_holds_all(read(tmp_path / 'run.mcap'), (
        '/sat/imu/data_raw is read, not /accel: --gyro-topic chooses another',))


def test_a_missing_topic_is_an_error_that_lists_the_topics_present(tmp_path):
    with Writer(tmp_path / 'run.mcap') as writer:
        writer.write_imu(GYRO_TOPIC, GYRO)
    with pytest.raises(RecordError,
                       match='has no topic /star_tracker/centroids; it has /imu/data_raw'):
        read(tmp_path / 'run.mcap')


def test_a_topic_of_another_type_is_an_error_that_names_it(tmp_path):
    rows = [(GYRO_TOPIC, CLOUD_TYPE, t, data) for topic, _, t, data in messages()
            if topic == FRAMES_TOPIC]
    with pytest.raises(RecordError, match=f'{GYRO_TOPIC} is of type {CLOUD_TYPE}, not {IMU_TYPE}'):
        read(write_with_mcap(tmp_path / 'run.mcap', rows))


def test_a_topic_without_messages_is_no_samples(tmp_path):
    recording = read(write(tmp_path / 'run.mcap', frames=Frames.empty()))
    assert len(recording.frames) == 0 and len(recording.gyro) == len(GYRO)


def test_the_summary_tells_what_a_recording_holds(tmp_path):
    path = write(tmp_path / 'run.mcap')
    result = summary(path)
    gyro, frames = result.topics
    assert (gyro.topic, gyro.type, gyro.count) == (GYRO_TOPIC, IMU_TYPE, 1000)
    assert (gyro.first_ns, gyro.last_ns) == (GYRO.stamp_ns[0], GYRO.stamp_ns[-1])
    assert gyro.rate_hz == pytest.approx(100.0) and frames.rate_hz == pytest.approx(2.0)
    assert frames.qos == 'reliable, volatile, keep_last 100'
    assert result.attachments == {'config.yaml': 5, 'truth.json': 2}
    assert result.duration_s == pytest.approx(9.99)
    assert result.n_bytes == path.stat().st_size and result.warnings == ()


def test_the_summary_of_a_database_is_that_of_the_same_messages_in_mcap(tmp_path):
    one, other = (summary(write_with_rosbags(tmp_path / storage.name, messages(),
                                             storage_plugin=storage))
                  for storage in rosbag2.StoragePlugin)
    assert one.topics == other.topics and one.duration_s == other.duration_s
    assert [row.qos for row in one.topics] == [row.qos for row in other.topics]


def test_batches_of_equal_time_are_written_in_the_order_given(tmp_path):
    times = np.full(3, START_NS)
    with Writer(tmp_path / 'run.mcap') as writer:
        writer.write_batches(*(Batch(f'/{name}', 'std_msgs/msg/Empty', times, [b'\0\1\0\0\0'] * 3)
                               for name in 'ba'))
    with (tmp_path / 'run.mcap').open('rb') as stream:
        found = [channel.topic for _, channel, _ in make_reader(stream).iter_messages()]
    assert found == ['/b'] * 3 + ['/a'] * 3
