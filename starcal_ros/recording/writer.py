# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings written as MCAP with profile `ros2`, as rosbag2 would.

Each topic carries the complete definition of its type (``ros2msg``), the hash of the type and
the QoS its publisher offers, so that ``ros2 bag play``, rosbags and Foxglove need nothing else.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import time
from types import TracebackType

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from starcal_ros.core.arrays import Ints
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.messages import foxglove
from starcal_ros.messages.cdr import RecordError
from starcal_ros.messages.cdr_imu import IMU_TYPE, encode_imu
from starcal_ros.messages.cdr_pointcloud import CLOUD_TYPE, encode_centroids
from starcal_ros.messages.contents import Types
from starcal_ros.recording import bag_metadata
from starcal_ros.recording.bag_metadata import Offer, Part
from starcal_ros.recording.mcap_writer import McapWriter
from starcal_ros.recording.qos import Qos


@dataclass(frozen=True)
class Batch:
    """Messages of one topic.

    Attributes
    ----------
    topic, type_name : str
        As in ``/imu/data_raw`` and ``sensor_msgs/msg/Imu``.
    log_time_ns : (n,) int64 array
        When each was recorded.
    messages : (n, size) uint8 array, or n bytes
        The messages in CDR.
    qos : tuple of Qos
        What each publisher offers.
    """

    topic: str
    type_name: str
    log_time_ns: Ints
    messages: NDArray[np.uint8] | Sequence[bytes]
    qos: tuple[Qos, ...] = (Qos(),)


def imu_batch(topic: str, samples: GyroSamples, frame_id: str = 'gyro',
              angular_velocity_variance: float = 0.0) -> Batch:
    """Encode gyro samples, recorded at their stamps; see `encode_imu`."""
    return Batch(topic, IMU_TYPE, samples.stamp_ns,
                 encode_imu(samples, frame_id, angular_velocity_variance))


def centroids_batch(topic: str, frames: Frames) -> Batch:
    """Encode star frames, recorded at their stamps."""
    return Batch(topic, CLOUD_TYPE, frames.stamp_ns, encode_centroids(frames))


@cache
def typestore() -> Typestore:
    """Return the messages of ROS 2 Kilted, and Foxglove's: Python types, definitions, hashes."""
    store = get_typestore(Stores.ROS2_KILTED)
    for name, text in foxglove.DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


TYPES = Types(lambda name: typestore().types[name], lambda values: values)
"""The message classes that `serialize` takes."""


def serialize(type_name: str, message: object) -> bytes:
    """Encode one message of a type of :func:`typestore`, little-endian."""
    return bytes(typestore().serialize_cdr(message, type_name, little_endian=True))


class Writer:
    """Write one recording; a context manager.

    What has been written can be read after `close`, and all but the last second of it also when
    the process is killed before.

    Parameters
    ----------
    path : path
        The file to make, usually `*.mcap`.
    overwrite : bool
        Replace a file that exists.
    chunk_s : int
        Seconds of log time in a chunk, at most: what is lost where the process is killed. Readers
        are faster over long ones.

    Raises
    ------
    RecordError
        If the file exists and is not to be overwritten, or cannot be made.

    Attributes
    ----------
    custom : dict of str
        Texts for the metadata, by name.
    """

    def __init__(self, path: str | Path, overwrite: bool = False, chunk_s: int = 1) -> None:
        self.path = Path(path)
        try:
            self._stream = self.path.open('wb' if overwrite else 'xb', buffering=0)
        except FileExistsError:
            raise RecordError(f'{path} exists; choose another name or overwrite it') from None
        except OSError as error:
            raise RecordError(f'{path} cannot be written: {error.strerror}') from error
        self._mcap = McapWriter(self._stream, 'ros2', library(), chunk_s)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, tuple[int, str]] = {}
        self._offers: dict[int, Offer] = {}
        self.custom: dict[str, str] = {}

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()

    def write(self, topic: str, type_name: str, cdr: bytes | memoryview, log_time_ns: int,
              publish_time_ns: int | None = None, qos: Qos = Qos()) -> None:
        """Write one message in CDR; `qos` counts with the first message of a topic.

        Raises
        ------
        RecordError
            If the type is not known or not that of the topic.
        """
        self._mcap.add_message(self._channel(topic, type_name, (qos,)), log_time_ns,
                               log_time_ns if publish_time_ns is None else publish_time_ns, cdr)

    def write_imu(self, topic: str, samples: GyroSamples, frame_id: str = 'gyro',
                  angular_velocity_variance: float = 0.0) -> None:
        """Write gyro samples, recorded at their stamps."""
        self.write_batches(imu_batch(topic, samples, frame_id, angular_velocity_variance))

    def write_centroids(self, topic: str, frames: Frames) -> None:
        """Write star frames, recorded at their stamps."""
        self.write_batches(centroids_batch(topic, frames))

    def write_batches(self, *batches: Batch) -> None:
        """Write the messages of some topics together, in the order of their log times.

        Raises
        ------
        RecordError
            If a type is not known or not that of its topic.
        """
        channels = [self._channel(batch.topic, batch.type_name, batch.qos) for batch in batches]
        lengths = [len(batch.log_time_ns) for batch in batches]
        log_time = np.concatenate([np.empty(0, np.int64)] + [b.log_time_ns for b in batches])
        source = np.repeat(np.arange(len(batches)), lengths)
        row = np.arange(len(log_time)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        order = np.argsort(log_time, kind='stable')
        log_time, source, row = log_time[order], source[order], row[order]
        breaks = ((np.diff(source) != 0) | (np.diff(row) != 1)
                  | (np.diff(self._mcap.slot(log_time)) != 0))
        edges = np.concatenate(([0], np.flatnonzero(breaks) + 1, [len(row)])).tolist()
        for low, high in zip(edges[:-1], edges[1:] if len(row) else []):
            batch, channel = batches[source[low]], channels[source[low]]
            messages = batch.messages[row[low]:row[low] + high - low]
            if isinstance(messages, np.ndarray):
                self._mcap.add_rows(channel, log_time[low:high], messages)
            else:
                for time_ns, message in zip(log_time[low:high].tolist(), messages):
                    self._mcap.add_message(channel, time_ns, time_ns, message)

    @property
    def offers(self) -> Counter[Offer]:
        """Number of messages of each topic."""
        counts = self._mcap.counts
        return Counter({offer: counts[channel] for channel, offer in self._offers.items()})

    @property
    def part(self) -> Part:
        """What the metadata say of the file, without what is pending."""
        return Part(self.path.name, self._mcap.span_ns, self._mcap.counts.total())

    @property
    def n_bytes(self) -> int:
        """Length of the file, without what is pending."""
        return self._mcap.n_bytes

    @property
    def n_chunks(self) -> int:
        """Number of chunks in the file."""
        return self._mcap.n_chunks

    @property
    def is_removed(self) -> bool:
        """Tell whether the file has no name any more, so that nobody can ever read it."""
        return os.fstat(self.fileno()).st_nlink == 0

    def fileno(self) -> int:
        """Return the descriptor of the file."""
        return self._stream.fileno()

    def note(self, name: str, values: dict[str, str]) -> None:
        """Add texts by names; of several of one name the last ones hold."""
        self._mcap.add_metadata(name, values)

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """Attach a file, such as the configuration."""
        self._mcap.add_attachment(name, media_type, data, time.time_ns())

    def flush(self) -> None:
        """Put all messages so far into the file, in a chunk of their own."""
        self._mcap.finish_chunk()

    def close(self) -> None:
        """Write what is pending and the summary; more calls do nothing."""
        if not self._stream.closed:
            with self._stream:
                self.flush()
                self._mcap.add_metadata(bag_metadata.RECORD, {
                    bag_metadata.KEY: bag_metadata.dump(bag_metadata.information(
                        [self.part], self.offers, self.custom))})
                self._mcap.finish()

    def _channel(self, topic: str, type_name: str, qos: tuple[Qos, ...]) -> int:
        """Return the id of a topic, declared at its first message."""
        if topic not in self._channels:
            if type_name not in self._schemas:
                self._schemas[type_name] = self._mcap.add_schema(
                    type_name, 'ros2msg', _definition(type_name).encode())
            profiles = '\n'.join(offer.profile for offer in qos)
            type_hash = typestore().hash_rihs01(type_name)
            channel = self._mcap.add_channel(topic, 'cdr', self._schemas[type_name], {
                'offered_qos_profiles': profiles, 'topic_type_hash': type_hash})
            self._channels[topic] = channel, type_name
            self._offers[channel] = Offer(topic, type_name, 'cdr', profiles, type_hash)
        channel, declared = self._channels[topic]
        if declared != type_name:
            raise RecordError(f'{topic} is of type {declared}, not {type_name}')
        return channel


def _definition(type_name: str) -> str:
    if type_name not in typestore().types:
        raise RecordError(f"'{type_name}' is not a message of ROS 2's standard packages")
    return typestore().generate_msgdef(type_name, ros_version=2)[0]


def library() -> str:
    """Return what a file names as its writer."""
    try:
        return f'starcal_ros {version("starcal_ros")}'
    except PackageNotFoundError:
        return 'starcal_ros (not installed)'
