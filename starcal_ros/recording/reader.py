# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings read as arrays: the gyro samples and star frames of a bag, and what else is in it.

Any rosbag2 directory or single MCAP file with the two sensor topics can be read, whoever wrote
it; frames may come from images instead, by a function that measures them. Samples and frames
come in the order in which they were recorded, just as a live node would have received them;
nothing is sorted by stamp, thinned or repaired.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.arrays import Ints
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.messages.cdr import Messages, RecordError
from starcal_ros.messages.cdr_image import IMAGE_TYPE
from starcal_ros.messages.cdr_imu import IMU_TYPE, decode_imu
from starcal_ros.messages.cdr_pointcloud import CLOUD_TYPE, decode_centroids
from starcal_ros.messages.topics import (ATTITUDE, CENTROIDS, IMAGES, IMU, RESIDUALS, SPOTS,
                                         TRUE_CENTROIDS)
from starcal_ros.recording.bag import Bag, RecordedTopic, open_bag

GYRO_TOPIC = IMU.recorded
FRAMES_TOPIC = CENTROIDS.recorded
IMAGES_TOPIC = IMAGES.recorded
CONFIG_ATTACHMENT, TRUTH_ATTACHMENT = 'config.yaml', 'truth.json'

_NOT_OF_SENSORS = tuple(topic.recorded for topic in (
    ATTITUDE, RESIDUALS, SPOTS, TRUE_CENTROIDS))
_HASH_BYTES = 1 << 20


@dataclass(frozen=True)
class Recording:
    """What the sensors delivered, and where it came from.

    Attributes
    ----------
    gyro : GyroSamples
        All samples, in the order of recording.
    frames : Frames
        All star frames, in the order of recording.
    attachments : dict of bytes
        Attached files by name (configuration, truth).
    gyro_topic, frames_topic : str
        The topics they were read from, images where these were measured; '' for no gyro.
    path : Path
        The recording.
    sha256 : str
        Of its storage files, in their order.
    warnings : tuple of str
        What could not be read; empty for a sound recording.
    """

    gyro: GyroSamples
    frames: Frames
    attachments: dict[str, bytes]
    gyro_topic: str
    frames_topic: str
    path: Path
    sha256: str
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class TopicSummary:
    """One topic of a recording.

    Attributes
    ----------
    topic, type : str
        Its name and message type.
    count : int
        Number of messages.
    first_ns, last_ns : int or None
        When the first and last were recorded, None if there is none [ns since the epoch].
    rate_hz : float
        Mean rate, NaN below two messages.
    qos : str
        What its publishers offered, '' where not recorded.
    """

    topic: str
    type: str
    count: int
    first_ns: int | None
    last_ns: int | None
    rate_hz: float
    qos: str


@dataclass(frozen=True)
class Summary:
    """What a recording holds: its topics by name, attachments with sizes [bytes], span [s]."""

    topics: tuple[TopicSummary, ...]
    attachments: dict[str, int]
    duration_s: float
    n_bytes: int
    warnings: tuple[str, ...]


def read(path: str | Path, on_progress: Callable[[float], None] | None = None,
         needs_gyro: bool = True, measure: Callable[[Messages], Frames] | None = None,
         images_first: bool = False) -> Recording:
    """Read the gyro samples and star frames of a recording.

    The topics are ``/imu/data_raw`` and ``/star_tracker/centroids``, or else the only ones that
    end so (in a namespace), or else the only ones of their type (remapped), which a warning names.
    Where there are no centroids but images, ``/star_tracker/image_raw``, these are measured, if a
    function for it is given.

    Parameters
    ----------
    path : path
        One .mcap file or a rosbag2 directory.
    on_progress : callable, optional
        Called with the part that has been read, 0 to 1.
    needs_gyro : bool
        Refuse a recording without gyro readings.
    measure : callable, optional
        Takes sensor_msgs/Image in CDR and returns their star frames, one a message.
    images_first : bool
        Measure the images even where there are centroids.

    Raises
    ------
    RecordError
        If the path holds no recording, a topic is missing, ambiguous or of another type, or a
        message is cut short or not what its type says.
    """
    path = Path(path)
    bag = open_bag(path)
    topics = bag.topics()
    has_gyro = bool(_candidates(topics, GYRO_TOPIC, IMU_TYPE))
    gyro_topic = (_choose(topics, GYRO_TOPIC, IMU_TYPE, path) if needs_gyro or has_gyro
                  else None)
    frames_topic, decode = _frames_topic(topics, path, measure, images_first)
    chosen = [*([gyro_topic] if gyro_topic else []), frames_topic]
    times: dict[str, list[Ints]] = {topic.name: [] for topic in chosen}
    gyro_parts, frames_parts = [], []
    for name, log_time, messages, done in bag.messages(times):
        try:
            if name == frames_topic.name:
                frames_parts.append(decode(messages))
            else:
                gyro_parts.append(decode_imu(messages))
        except RecordError as error:
            raise RecordError(f'{path}: {name}: {error}') from None
        times[name].append(log_time)
        if on_progress:
            on_progress(done)
    gyro, frames = GyroSamples.concatenate(gyro_parts), Frames.concatenate(frames_parts)
    read_ = (len(gyro), len(frames))[-len(chosen):]
    wanted = (*([GYRO_TOPIC] if gyro_topic else []),
              IMAGES_TOPIC if decode is measure else FRAMES_TOPIC)
    elsewhere = [f'{topic.name} is taken for {name}' for topic, name in zip(chosen, wanted)
                 if not topic.name.endswith(name)]
    lost = [f'{count} of {topic.count} messages on {topic.name} could be read'
            for topic, count in zip(chosen, read_) if count != topic.count]
    recording = Recording(
        gyro if gyro_topic is None else _arrange_gyro(gyro, times[gyro_topic.name]),
        _arrange_frames(frames, times[frames_topic.name]), bag.attachments,
        gyro_topic.name if gyro_topic else '', frames_topic.name, path, _sha256(bag),
        (*bag.warnings, *elsewhere, *lost))
    if on_progress:
        on_progress(1.0)
    return recording


def summary(path: str | Path) -> Summary:
    """Tell what a recording holds, without decoding it.

    Raises
    ------
    RecordError
        If the path holds no recording.
    """
    bag = open_bag(Path(path))
    rows, spans = [], []
    for topic in bag.topics():
        log_time = bag.log_times(topic.name)
        first, last = (int(log_time.min()), int(log_time.max())) if log_time.size else (None, None)
        rate = np.nan
        if first is not None and last is not None:
            spans += [first, last]
            rate = (log_time.size - 1) / (last - first) * 1e9 if last > first else np.nan
        rows.append(TopicSummary(topic.name, topic.type, topic.count, first, last, rate,
                                 topic.qos))
    return Summary(tuple(rows), {name: len(data) for name, data in bag.attachments.items()},
                   (max(spans) - min(spans)) / 1e9 if spans else 0.0,
                   sum(file.stat().st_size for file in bag.files), bag.warnings)


def _frames_topic(topics: list[RecordedTopic], path: Path,
                  measure: Callable[[Messages], Frames] | None, images_first: bool
                  ) -> tuple[RecordedTopic, Callable[[Messages], Frames]]:
    """Find the topic of the star frames, and what makes frames of its messages."""
    stars = _candidates(topics, FRAMES_TOPIC, CLOUD_TYPE)
    images = _candidates(topics, IMAGES_TOPIC, IMAGE_TYPE)
    if measure is not None and (images_first or images and (
            not stars or images[0].name.endswith(IMAGES_TOPIC)
            and not stars[0].name.endswith(FRAMES_TOPIC))):
        return _choose(topics, IMAGES_TOPIC, IMAGE_TYPE, path), measure
    return _choose(topics, FRAMES_TOPIC, CLOUD_TYPE, path), decode_centroids


def _candidates(topics: list[RecordedTopic], wanted: str, wanted_type: str) -> list[RecordedTopic]:
    """Return the topic of a name, or those that end with it, or those of its type."""
    return ([topic for topic in topics if topic.name == wanted]
            or [topic for topic in topics if topic.name.endswith(wanted)]
            or [topic for topic in topics
                if topic.type == wanted_type and not topic.name.endswith(_NOT_OF_SENSORS)])


def _choose(topics: list[RecordedTopic], wanted: str, wanted_type: str, path: Path
            ) -> RecordedTopic:
    """Find the only candidate for a topic."""
    found = _candidates(topics, wanted, wanted_type)
    if len(found) != 1:
        listed = ', '.join(topic.name for topic in found or topics) or 'no topics'
        raise RecordError(f'{path} has several topics {wanted}: {listed}' if found else
                          f'{path} has no topic {wanted}; it has {listed}')
    topic = found[0]
    if topic.type != wanted_type:
        raise RecordError(f'{path}: {topic.name} is of type {topic.type or "unknown"}, '
                          f'not {wanted_type}')
    if topic.encoding != 'cdr':
        raise RecordError(f"{path}: {topic.name} has encoding '{topic.encoding}', not 'cdr'")
    return topic


def _arrange_gyro(gyro: GyroSamples, times: list[Ints]) -> GyroSamples:
    order = _order(times)
    return gyro if order is None else GyroSamples(gyro.stamp_ns[order], gyro.rate[order])


def _arrange_frames(frames: Frames, times: list[Ints]) -> Frames:
    order = _order(times)
    return frames if order is None else frames.take(order)


def _order(times: list[Ints]) -> NDArray[np.intp] | None:
    """Return the order of recording, None where it is that of the file already."""
    log_time = np.concatenate([np.empty(0, np.int64), *times])
    if (np.diff(log_time) >= 0).all():
        return None
    return np.argsort(log_time, kind='stable')


def _sha256(bag: Bag) -> str:
    digest = hashlib.sha256()
    for file in bag.files:
        with file.open('rb') as stream:
            while block := stream.read(_HASH_BYTES):
                digest.update(block)
    return digest.hexdigest()
