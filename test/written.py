# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A recording whose content is known, written by this package and by others."""

import mcap.writer
import numpy as np
from rosbags import rosbag2
import yaml

from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.messages.cdr_imu import IMU_TYPE, encode_imu
from starcal_ros.messages.cdr_pointcloud import CLOUD_TYPE, encode_centroids
from starcal_ros.recording.reader import FRAMES_TOPIC, GYRO_TOPIC
from starcal_ros.recording.writer import Writer, centroids_batch, imu_batch, typestore

START_NS = 1_782_993_600_000_000_000


def sensors(n=1000, seed=5):
    """Make 100 Hz samples and 2 Hz frames with 0 to 6 stars."""
    rng = np.random.default_rng(seed)
    gyro = GyroSamples(START_NS + np.arange(1, n + 1) * 10**7, rng.normal(size=(n, 3)))
    counts = rng.integers(0, 7, n // 50)
    m = counts.sum()
    frames = Frames(START_NS + np.arange(1, n // 50 + 1) * 500_000_000 - 3_000_000,
                    np.concatenate(([0], np.cumsum(counts))), rng.uniform(0, 2048, (m, 2)),
                    rng.integers(1, 9, m) / 64, rng.integers(8, 26, m) / 4,
                    rng.integers(0, 118323, m))
    return gyro, frames


GYRO, FRAMES = sensors()


def write(path, gyro=GYRO, frames=FRAMES, gyro_topic=GYRO_TOPIC, frames_topic=FRAMES_TOPIC):
    """Write a recording with two attachments."""
    with Writer(path) as writer:
        writer.attach('config.yaml', b'a: 1\n', 'application/yaml')
        writer.write_batches(imu_batch(gyro_topic, gyro), centroids_batch(frames_topic, frames))
        writer.attach('truth.json', b'{}', 'application/json')
    return path


def messages():
    """Return (topic, type, log time, CDR) of all messages in the order of time."""
    rows = [(GYRO_TOPIC, IMU_TYPE, t, row.tobytes())
            for t, row in zip(GYRO.stamp_ns.tolist(), encode_imu(GYRO))]
    rows += [(FRAMES_TOPIC, CLOUD_TYPE, t, data)
             for t, data in zip(FRAMES.stamp_ns.tolist(), encode_centroids(FRAMES))]
    return sorted(rows, key=lambda row: row[2])


def write_with_mcap(path, rows, **options):
    """Write messages with the library of MCAP itself."""
    with path.open('wb') as stream:
        writer = mcap.writer.Writer(stream, **options)
        writer.start('ros2', 'test')
        channels = {}
        for topic, type_name, log_time, data in rows:
            if topic not in channels:
                schema = writer.register_schema(type_name, 'ros2msg', b'')
                channels[topic] = writer.register_channel(topic, 'cdr', schema)
            writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()
    return path


def write_with_rosbags(path, rows, prepare=lambda bag: None, **options):
    """Write messages as a rosbag2 directory."""
    bag = rosbag2.Writer(path, version=9, **options)
    prepare(bag)
    with bag:
        topics = {}
        for topic, type_name, log_time, data in rows:
            if topic not in topics:
                topics[topic] = bag.add_connection(topic, type_name, typestore=typestore())
            bag.write(topics[topic], log_time, data)
    return path


def assert_same(one, other):
    """Compare samples or frames, NaN equal to NaN."""
    for name in vars(one):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def assert_holds_all(recording, warnings=()):
    """Check that a recording is that of `sensors`."""
    assert_same(recording.gyro, GYRO)
    assert_same(recording.frames, FRAMES)
    assert recording.warnings == warnings


def split(path, names=('a.mcap', 'b.mcap', 'c.mcap')):
    """Make a rosbag2 directory of several files."""
    path.mkdir()
    rows = messages()
    for k, name in enumerate(names):
        part = rows[k * len(rows) // len(names):(k + 1) * len(rows) // len(names)]
        write_with_mcap(path / name, part)
    (path / 'metadata.yaml').write_text(yaml.safe_dump({'rosbag2_bagfile_information': {
        'version': 9, 'storage_identifier': 'mcap', 'compression_mode': '',
        'relative_file_paths': list(names)}}))
    return path
