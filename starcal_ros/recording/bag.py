# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Bags: one MCAP file or a rosbag2 directory, whoever wrote it, behind one interface.

`bag_files` finds the files. MCAP is read by `mcap_reader`, whole chunks at a time; sqlite3 is
rare, and goes message by message through the `rosbags` library.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from heapq import merge
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
import zstandard

from starcal_ros.core.arrays import Ints
from starcal_ros.files.limits import CHUNK, LimitError
from starcal_ros.messages.cdr import Messages, RecordError
from starcal_ros.recording.bag_files import MCAP, BagFiles, find
from starcal_ros.recording.mcap_chunk import ZSTD_HEAD, unpack
from starcal_ros.recording.mcap_chunks import LATEST
from starcal_ros.recording.mcap_reader import GROUP_BYTES, McapFile

if TYPE_CHECKING:
    from rosbags.rosbag2 import Reader

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
    offered : frozenset of str
        QoS profiles that its publishers offered, as recorded (YAML); see `described`.
    count : int
        Number of messages that the bag holds.
    """

    name: str
    type: str
    encoding: str
    offered: frozenset[str]
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

    def in_order(self, names: Collection[str], within: Sequence[Span] | None = None,
                 ) -> Iterator[Stretch]:
        """Read the messages of some topics in the order of their recording.

        Parameters
        ----------
        names : collection of str
            The topics.
        within : sequence of Span, optional
            Times, in their order, without which nothing is read, but for neighbouring messages.
        """

    def span(self, name: str) -> Span | None:
        """Return when the first and last message of a topic were recorded, if there is one."""


class Span(NamedTuple):
    """A time, both ends included [ns]."""

    first_ns: int
    last_ns: int


class Stretch(NamedTuple):
    """A part of what `Bag.in_order` reads.

    Attributes
    ----------
    messages : list of (topic, log times, Messages)
        In whatever order.
    before_ns : int
        All messages that were recorded before that have been given by now.
    done : float
        How much has been read, 0 to 1.
    """

    messages: list[tuple[str, Ints, Messages]]
    before_ns: int
    done: float


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
                    frozenset([channel.metadata.get('offered_qos_profiles', '')]),
                    part.counts[channel.id]))
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

    def span(self, name: str) -> Span | None:
        spans = [span for part in self._parts for channel in part.channels.values()
                 if channel.topic == name and (span := part.span(channel.id))]
        return Span(min(span[0] for span in spans), max(span[1] for span in spans)) if (
            spans) else None

    def in_order(self, names: Collection[str], within: Sequence[Span] | None = None,
                 ) -> Iterator[Stretch]:
        wanted = [{channel.id: channel.topic for channel in part.channels.values()
                   if channel.topic in names} for part in self._parts]
        chunk, first, last, which = np.concatenate([np.empty((4, 0), np.int64), *(
            np.stack((*part.chunks.holding(wanted[k]), np.full(len(numbers), k)))
            for k, part in enumerate(self._parts)
            if len(numbers := part.chunks.holding(wanted[k])[0]))], axis=1)
        if within is not None:
            # Of the times that begin before a chunk ends, the last must end after it begins.
            ends = np.array(within, np.int64).reshape(-1, 2)
            at = np.searchsorted(ends[:, 0], last, side='right') - 1
            needed = (at >= 0) & (ends[at, 1] >= first)
            first, which, chunk = first[needed], which[needed], chunk[needed]
        order = np.lexsort((chunk, which, first))
        first, which, chunk = (each[order] for each in (first, which, chunk))
        group: list[int] = []
        n_bytes = 0
        for row, (k, number) in enumerate(zip(which.tolist(), chunk.tolist())):
            part = self._parts[k]
            group.append(number)
            n_bytes += part.chunks.chunk(number, []).size
            is_last = row + 1 == len(first)
            if not is_last and n_bytes < GROUP_BYTES and which[row + 1] == k:
                continue
            yield Stretch([
                (wanted[k][channel], log_time,
                 _unpack(messages) if self._found.by_message else messages)
                for channel, log_time, messages in part.read_chunks(group, wanted[k])],
                LATEST if is_last else int(first[row + 1]), (row + 1) / len(first))
            group, n_bytes = [], 0


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
                        frozenset([_profiles(connection.ext)]),
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

    def span(self, name: str) -> Span | None:
        log_time = self.log_times(name)
        return Span(int(log_time.min()), int(log_time.max())) if len(log_time) else None

    def in_order(self, names: Collection[str], within: Sequence[Span] | None = None,
                 ) -> Iterator[Stretch]:
        with ExitStack() as stack:
            readers = [stack.enter_context(_reader(part)) for part in self._found.parts]
            wanted = [[each for each in reader.connections if each.topic in names]
                      for reader in readers]
            total, read = max(sum(each.msgcount for part in wanted for each in part), 1), 0
            for begin, end in within or [Span(0, LATEST - 1)]:
                rest = merge(*(reader.messages(some, begin, end + 1)
                               for reader, some in zip(readers, wanted) if some),
                             key=itemgetter(1))
                while batch := list(islice(rest, _BATCH)):
                    read += len(batch)
                    found = []
                    for topic in {connection.topic for connection, _, _ in batch}:
                        own = [each for each in batch if each[0].topic == topic]
                        messages = Messages.join([bytes(data) for _, _, data in own])
                        found.append((topic, np.array([t for _, t, _ in own], np.int64),
                                      _unpack(messages) if self._found.by_message else messages))
                    yield Stretch(found, batch[-1][1], min(read / total, 1.0))


@contextmanager
def _reader(path: Path) -> Iterator[Reader]:
    """Open a file and turn the many errors of the libraries below into one."""
    from rosbags.rosbag2 import Reader
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
                         words([part.encoding for part in parts]),
                         frozenset[str]().union(*(part.offered for part in parts)),
                         sum(part.count for part in parts))


def described(offered: Iterable[str]) -> str:
    """Say what publishers offered, as in 'reliable, volatile, keep_last 100'; '' of nothing."""
    from rosbags.rosbag2.metadata import parse_qos
    from starcal_ros.files.documents import load_yaml
    words = set()
    for profiles in offered:
        try:
            words |= {f'{qos.reliability.name}, {qos.durability.name}, '
                      f'{qos.history.name} {qos.depth}'.lower()
                      for qos in parse_qos(load_yaml(profiles) or [])}
        except (LookupError, TypeError, ValueError, AttributeError):
            words.add('unreadable')
    return ' | '.join(sorted(words))


def _profiles(of_sqlite: Any) -> str:
    from rosbags.rosbag2.metadata import dump_qos_v9
    import yaml
    text: str = yaml.safe_dump([dict(each) for each in dump_qos_v9(
        getattr(of_sqlite, 'offered_qos_profiles', []))])
    return text
