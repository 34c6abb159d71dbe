# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bags: one MCAP file or a rosbag2 directory, whoever wrote it, behind one interface.

`bag_files` finds the files. MCAP is read by `mcap_reader`, whole chunks at a time; sqlite3 is
rare, and goes message by message through the `rosbags` library.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Protocol

import numpy as np
from rosbags.interfaces import Qos
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import parse_qos
import zstandard

from starcal_ros.core.arrays import Ints
from starcal_ros.files.documents import load_yaml
from starcal_ros.files.limits import CHUNK, LimitError
from starcal_ros.messages.cdr import Messages, RecordError
from starcal_ros.recording.bag_files import MCAP, BagFiles, find
from starcal_ros.recording.mcap_chunk import ZSTD_HEAD, unpack
from starcal_ros.recording.mcap_reader import McapFile

_BATCH = 10_000


@dataclass(frozen=True)
class RecordedTopic:
    """A topic of a bag.

    Attributes
    ----------
    name, type : str
        As in ``/imu/data_raw`` and ``sensor_msgs/msg/Imu``.
    encoding : str
        Of its messages; ROS 2 writes ``cdr``.
    qos : str
        What its publishers offered, for a reader; '' where not recorded.
    count : int
        Number of messages that the bag holds.
    """

    name: str
    type: str
    encoding: str
    qos: str
    count: int


class Bag(Protocol):
    """What is common to all bags."""

    files: list[Path]

    @property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the bag, so far as it has been read."""

    def topics(self) -> list[RecordedTopic]:
        """Return the topics, sorted by name."""

    def log_times(self, name: str) -> Ints:
        """Return when the messages of a topic were recorded, in the order of the bag, (n,) ns."""

    def messages(self, names: Collection[str],
                 ) -> Iterator[tuple[str, Ints, Messages, float]]:
        """Read the messages of some topics in batches, in the order of the bag.

        Yields
        ------
        name : str
            The topic of the batch.
        log_time : (n,) int64 array
            When its messages were recorded [ns].
        messages : Messages
            The messages.
        done : float
            How much of the bag has been read, 0 to 1.
        """


def open_bag(path: Path) -> Bag:
    """Open one recording.

    Raises
    ------
    RecordError
        If there is nothing at the path, or nothing that can be read as a recording.
    """
    found = find(path)
    return _McapBag(found) if found.storage == MCAP else _SqliteBag(found)


class _McapBag:
    """MCAP files, in the order of their recording."""

    def __init__(self, found: BagFiles) -> None:
        self.files = found.files
        self._found = found
        self._parts = [McapFile(file) for file in found.parts]

    @property
    def attachments(self) -> dict[str, bytes]:
        return {name: data for part in self._parts for name, data in part.attachments.items()}

    @property
    def warnings(self) -> tuple[str, ...]:
        return (*self._found.warnings, *(text for part in self._parts for text in part.warnings))

    def topics(self) -> list[RecordedTopic]:
        merged: dict[str, list[RecordedTopic]] = {}
        for part in self._parts:
            for channel in part.channels.values():
                schema = part.schemas.get(channel.schema_id)
                merged.setdefault(channel.topic, []).append(RecordedTopic(
                    channel.topic, schema.name if schema else '', channel.message_encoding,
                    _describe_yaml(channel.metadata.get('offered_qos_profiles', '')),
                    len(part.log_times(channel.id))))
        return [_merge(merged[name]) for name in sorted(merged)]

    def log_times(self, name: str) -> Ints:
        return np.concatenate([part.log_times(channel.id) for part in self._parts
                               for channel in part.channels.values() if channel.topic == name])

    def messages(self, names: Collection[str],
                 ) -> Iterator[tuple[str, Ints, Messages, float]]:
        n_bytes = sum(len(part.data) for part in self._parts)
        before = 0
        for part in self._parts:
            wanted = {channel.id: channel.topic for channel in part.channels.values()
                      if channel.topic in names}
            for channel_id, log_time, messages in part.messages(wanted):
                done = (before + part.position) / n_bytes
                yield (wanted[channel_id], log_time,
                       _unpack(messages) if self._found.by_message else messages, done)
            before += len(part.data)


class _SqliteBag:
    """Files of sqlite3, read one by one: what their metadata says of them may be wrong."""

    attachments: dict[str, bytes] = {}

    def __init__(self, found: BagFiles) -> None:
        self.files, self.warnings = found.files, found.warnings
        self._found = found

    def topics(self) -> list[RecordedTopic]:
        topics: dict[str, list[RecordedTopic]] = {}
        for part in self._found.parts:
            with _reader(part) as reader:
                for connection in reader.connections:
                    topics.setdefault(connection.topic, []).append(RecordedTopic(
                        connection.topic, connection.msgtype,
                        getattr(connection.ext, 'serialization_format', ''),
                        _describe(getattr(connection.ext, 'offered_qos_profiles', [])),
                        connection.msgcount))
        return [_merge(topics[name]) for name in sorted(topics)]

    def log_times(self, name: str) -> Ints:
        return np.concatenate([np.empty(0, np.int64)]
                              + [log_time for _, log_time, _, _ in self.messages([name])])

    def messages(self, names: Collection[str],
                 ) -> Iterator[tuple[str, Ints, Messages, float]]:
        n_parts = len(self._found.parts)
        for index, part in enumerate(self._found.parts):
            with _reader(part) as reader:
                wanted = [c for c in reader.connections if c.topic in names]
                for k, connection in enumerate(wanted):
                    rest = reader.messages([connection])
                    done = (index + k / len(wanted)) / n_parts
                    while batch := list(islice(rest, _BATCH)):
                        messages = Messages.join([bytes(data) for _, _, data in batch])
                        yield (connection.topic, np.array([t for _, t, _ in batch], np.int64),
                               _unpack(messages) if self._found.by_message else messages, done)


@contextmanager
def _reader(path: Path) -> Iterator[Reader]:
    """Open a file and turn the many errors of the libraries below into one."""
    try:
        with Reader(path) as reader:
            yield reader
    except RecordError:
        raise
    except Exception as error:
        raise RecordError(f'{path} cannot be read: {" ".join(str(error).split())}') from error


def _unpack(messages: Messages) -> Messages:
    """Decompress messages that are compressed one by one."""
    whole = messages.data.data
    unpacked = []
    try:
        for start, size in zip(messages.start.tolist(), messages.size.tolist()):
            packed = whole[start:start + size]
            stated = zstandard.get_frame_parameters(packed[:ZSTD_HEAD]).content_size
            known = stated != zstandard.CONTENTSIZE_UNKNOWN
            unpacked.append(unpack('zstd', packed, stated if known else CHUNK.value))
    except (zstandard.ZstdError, LimitError, MemoryError) as error:
        raise RecordError(f'a compressed message cannot be unpacked: {error}') from None
    return Messages.join(unpacked)


def _merge(parts: list[RecordedTopic]) -> RecordedTopic:
    """Join what several channels or files say of one topic."""
    def words(values: list[str]) -> str:
        return ' | '.join(sorted(set(filter(None, values))))
    return RecordedTopic(parts[0].name, words([part.type for part in parts]),
                         words([part.encoding for part in parts]), words(
                             [part.qos for part in parts]),
                         sum(part.count for part in parts))


def _describe_yaml(profiles: str) -> str:
    try:
        return _describe(parse_qos(load_yaml(profiles) or []))
    except (LookupError, TypeError, ValueError, AttributeError):
        return 'unreadable'


def _describe(profiles: list[Qos]) -> str:
    """Say what publishers offered, as in 'reliable, volatile, keep_last 100'."""
    return ' | '.join(sorted({
        f'{qos.reliability.name}, {qos.durability.name}, {qos.history.name} {qos.depth}'.lower()
        for qos in profiles}))
