# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The gyro samples and star frames of a recording, in batches in the order of recording.

Chunks are read in the order of their log times, so that what is held at once is a few megabytes
of a file whose chunks follow each other in time, however long it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from starcal_ros.core.arrays import Ints
from starcal_ros.measurements.message_source import MessageBatch
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.messages.cdr import Messages, RecordError, frame_id
from starcal_ros.messages.cdr_imu import decode_imu
from starcal_ros.messages.cdr_pointcloud import decode_centroids
from starcal_ros.recording.bag import Bag, RecordedTopic, Span, open_bag
from starcal_ros.recording.bag_files import refuse_ros1
from starcal_ros.recording.mcap_chunks import LATEST
from starcal_ros.recording.topic_choice import (FRAMES, GYRO, IMAGE, TopicChoice, candidates,
                                                choose, notice)

_HASH_BYTES = 1 << 20

Samples = TypeVar('Samples', GyroSamples, Frames)


class RecordingStream:
    """A recording that can be read again and again.

    Parameters
    ----------
    path, needs_gyro, measure, images_first, choice
        As of `reader.read`.

    Attributes
    ----------
    path : Path
        The recording.
    gyro_topic, frames_topic : str
        The topics that are read, images where these are measured; '' for no gyro.
    measured : bool
        Whether the frames are measured in images.
    frame_ids : dict of str
        By topic: the frame_id of the first message that was read.

    Raises
    ------
    RecordError
        As `reader.read`.
    """

    def __init__(self, path: str | Path, needs_gyro: bool = True,
                 measure: Callable[..., Frames] | None = None, images_first: bool = False,
                 choice: TopicChoice = TopicChoice()) -> None:
        self.path = Path(path)
        self._bag = open_bag(self.path)
        topics = self._bag.topics()
        refuse_ros1(topics, self.path)
        has_gyro = choice.gyro is not None or bool(candidates(topics, GYRO))
        try:
            gyro = (choose(self._bag, GYRO, self.path, choice.gyro)
                    if needs_gyro or has_gyro else None)
            frames, self._decode = _frames_topic(
                self._bag, self.path, measure, images_first, choice)
        except RecordError as error:        # what is missing may be what could not be read
            raise RecordError('; '.join((str(error), *self._bag.warnings))) from None
        self._topics = [*([gyro] if gyro else []), frames]
        self.gyro_topic, self.frames_topic = gyro.name if gyro else '', frames.name
        self.measured = self._decode is not decode_centroids
        self.frame_ids: dict[str, str | None] = {}
        self._counted: dict[str, int] | None = None
        found = [(GYRO, gyro, choice.gyro), (
            (IMAGE, frames, choice.images) if self.measured else
            (FRAMES, frames, choice.frames))]
        self._notices = [text for role, topic, given in found if topic and not given
                         and (text := notice(topics, role, topic))]
        self._notices += [f'{topic.name} has no schema: its name is believed'
                          for topic in self._topics if not topic.type]

    @property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name (configuration, truth)."""
        return self._bag.attachments

    @property
    def warnings(self) -> tuple[str, ...]:
        """What could not be read, so far; empty for a sound recording."""
        lost = [f'{self._counted[topic.name]} of {topic.count} messages on {topic.name} could be '
                'read' for topic in self._topics
                if self._counted is not None and self._counted[topic.name] != topic.count]
        return (*self._bag.warnings, *self._notices, *lost)

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of its storage files, in their order."""
        import hashlib
        digest = hashlib.sha256()
        for file in self._bag.files:
            with file.open('rb') as stream:
                while block := stream.read(_HASH_BYTES):
                    digest.update(block)
        return digest.hexdigest()

    def span(self, topic: str) -> Span | None:
        """Return when the first and last message of a topic were recorded."""
        return self._bag.span(topic)

    def batches(self, within: Sequence[Span] | None = None) -> Iterator[MessageBatch]:
        """Read all messages, or those that were recorded within some times, in their order.

        Raises
        ------
        RecordError
            If a message is cut short or not what its type says.
        """
        gyro, frames = _Held(GyroSamples), _Held(Frames)
        counted = {topic.name: 0 for topic in self._topics}
        done = 0.0
        for stretch in self._bag.in_order(list(counted), within):
            for name, log_time, messages in stretch.messages:
                counted[name] += len(messages)
                self._keep_frame_id(name, messages)
                if within is not None:
                    log_time, messages = _within(log_time, messages, within)
                if name == self.frames_topic:
                    frames.add(log_time, self._decoded(name, messages, self._decode))
                else:
                    gyro.add(log_time, self._decoded(name, messages, decode_imu))
            done = stretch.done
            yield MessageBatch(gyro.take(stretch.before_ns), frames.take(stretch.before_ns), done)
        if gyro or frames:
            yield MessageBatch(gyro.take(LATEST), frames.take(LATEST), 1.0)
        if within is None:
            self._counted = counted

    def readings(self, within: Sequence[Span]) -> Iterator[tuple[Ints, GyroSamples]]:
        """Read the gyro samples that were recorded within some times, and when that was."""
        for stretch in self._bag.in_order([self.gyro_topic], within):
            for name, log_time, messages in stretch.messages:
                log_time, messages = _within(log_time, messages, within)
                yield log_time, self._decoded(name, messages, decode_imu)

    def _decoded(self, name: str, messages: Messages, decode: Callable[[Messages], Samples]
                 ) -> Samples:
        try:
            return decode(messages)
        except RecordError as error:
            raise RecordError(f'{self.path}: {name}: {error}') from None

    def _keep_frame_id(self, name: str, messages: Messages) -> None:
        if name not in self.frame_ids and len(messages):
            begin, size = int(messages.start[0]), int(messages.size[0])
            self.frame_ids[name] = frame_id(messages.data[begin:begin + size].tobytes())


class _Held(Generic[Samples]):
    """Messages of one topic that may have to wait for earlier ones of another chunk."""

    def __init__(self, kind: type[Samples]) -> None:
        self._kind: type[Samples] = kind
        self._times: list[Ints] = []
        self._parts: list[Samples] = []

    def __bool__(self) -> bool:
        return bool(self._parts)

    def add(self, log_time: Ints, samples: Samples) -> None:
        """Take messages."""
        if len(log_time):
            self._times.append(log_time)
            self._parts.append(samples)

    def take(self, before_ns: int) -> Samples:
        """Return what was recorded before a time, in that order."""
        times = np.concatenate([np.empty(0, np.int64), *self._times])
        samples = self._kind.concatenate(self._parts)
        if (np.diff(times) < 0).any():
            order = np.argsort(times, kind='stable')
            times, samples = times[order], samples.take(order)
        ready = len(times) if before_ns == LATEST else int(np.searchsorted(times, before_ns))
        self._times, self._parts = ([times[ready:]], [samples[ready:]]) if (
            ready < len(times)) else ([], [])
        return samples[:ready]


def _within(log_time: Ints, messages: Messages, within: Sequence[Span]
            ) -> tuple[Ints, Messages]:
    """Return the messages that were recorded within some times, which are in their order."""
    ends = np.array(within, np.int64).reshape(-1, 2)
    at = np.searchsorted(ends[:, 0], log_time, side='right') - 1
    inside = (at >= 0) & (log_time <= ends[at, 1])
    return log_time[inside], messages.take(inside)


def _frames_topic(bag: Bag, path: Path, measure: Callable[..., Frames] | None,
                  images_first: bool, choice: TopicChoice
                  ) -> tuple[RecordedTopic, Callable[[Messages], Frames]]:
    """Find the topic of the star frames, and what makes frames of its messages."""
    stars = candidates(bag.topics(), FRAMES)
    images = candidates(bag.topics(), IMAGE)
    if measure is not None and (images_first or choice.frames is None and (
            choice.images is not None or images and (
                not stars or images[0].name.endswith(IMAGE.topic)
                and not stars[0].name.endswith(FRAMES.topic)))):
        topic = choose(bag, IMAGE, path, choice.images)
        return topic, partial(measure, message_type=topic.type)
    return choose(bag, FRAMES, path, choice.frames), decode_centroids
