# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Recordings read as arrays: the gyro samples and star frames of a bag, and what else is in it.

Any rosbag2 directory or single MCAP file with the two sensor topics can be read, whoever wrote
it; frames may come from images instead, by a function that measures them. Samples and frames
come in the order in which they were recorded, just as a live node would have received them;
nothing is sorted by stamp, thinned or repaired.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.arrays import Ints
from starcal_ros.measurements.samples import Frames, GyroSamples
from starcal_ros.messages.cdr import RecordError, stamps_ns
from starcal_ros.messages.cdr_imu import decode_imu
from starcal_ros.recording.bag import Bag, described, open_bag
from starcal_ros.recording.recording_stream import RecordingStream
from starcal_ros.recording.topic_choice import (FRAMES, GYRO, TopicChoice, choose, mean_rate_hz,
                                                notice)

GYRO_TOPIC, FRAMES_TOPIC = GYRO.topic, FRAMES.topic
CONFIG_ATTACHMENT, TRUTH_ATTACHMENT = 'config.yaml', 'truth.json'

_NONE = np.empty(0, np.int64)


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
    measured : bool
        Whether the frames were measured in images.
    """

    gyro: GyroSamples
    frames: Frames
    attachments: dict[str, bytes]
    gyro_topic: str
    frames_topic: str
    path: Path
    sha256: str
    warnings: tuple[str, ...]
    measured: bool = False


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
    offered : frozenset of str
        QoS profiles of its publishers, as recorded: one and the same offer has many forms.
    """

    topic: str
    type: str
    count: int
    first_ns: int | None
    last_ns: int | None
    rate_hz: float
    offered: frozenset[str] = field(compare=False)

    @property
    def qos(self) -> str:
        """What its publishers offered, in words; '' where not recorded."""
        return described(self.offered)


@dataclass(frozen=True)
class Summary:
    """What a recording holds: its topics by name, attachments with sizes [bytes], span [s]."""

    topics: tuple[TopicSummary, ...]
    attachments: dict[str, int]
    duration_s: float
    n_bytes: int
    warnings: tuple[str, ...]


def read(path: str | Path, on_progress: Callable[[float], None] | None = None,
         needs_gyro: bool = True, measure: Callable[..., Frames] | None = None,
         images_first: bool = False, choice: TopicChoice = TopicChoice()) -> Recording:
    """Read the gyro samples and star frames of a recording.

    The topics are ``/imu/data_raw`` and ``/star_tracker/centroids``, or else the only ones that
    end so (in a namespace), or else the only ones of their type (remapped), which a warning names;
    or those that are chosen.
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
        Takes images in CDR, and their ``message_type``, sensor_msgs/Image or CompressedImage;
        returns their star frames, one a message.
    images_first : bool
        Measure the images even where there are centroids.
    choice : TopicChoice
        Names of topics; images that are named, and no centroids, are measured.

    Raises
    ------
    RecordError
        If the path holds no recording, a topic is missing, ambiguous or of another type, or a
        message is cut short or not what its type says.
    """
    stream = RecordingStream(path, needs_gyro, measure, images_first, choice)
    gyro_parts, frames_parts = [], []
    for gyro, frames, done in stream.batches():
        gyro_parts.append(gyro)
        frames_parts.append(frames)
        if on_progress:
            on_progress(done)
    recording = Recording(
        GyroSamples.concatenate(gyro_parts), Frames.concatenate(frames_parts),
        stream.attachments, stream.gyro_topic, stream.frames_topic, stream.path, stream.sha256,
        stream.warnings, stream.measured)
    if on_progress:
        on_progress(1.0)
    return recording


def read_gyro(path: str | Path, on_progress: Callable[[float], None] | None = None,
              given: str | None = None) -> tuple[GyroSamples, str, tuple[str, ...]]:
    """Read the gyro samples alone; stars need not be there.

    Returns
    -------
    gyro : GyroSamples
        All samples, in the order of recording.
    topic : str
        Where they were read.
    warnings : tuple of str
        What could not be read.

    Raises
    ------
    RecordError
        As `read`.
    """
    bag, path = open_bag(Path(path)), Path(path)
    topic = choose(bag, GYRO, path, given)
    times: list[Ints] = []
    parts: list[GyroSamples] = []
    for name, log_time, messages, done in bag.messages([topic.name]):
        try:
            parts.append(decode_imu(messages))
        except RecordError as error:
            raise RecordError(f'{path}: {name}: {error}') from None
        times.append(log_time)
        if on_progress:
            on_progress(done)
    found = None if given else notice(bag.topics(), GYRO, topic)
    gyro = _arrange_gyro(GyroSamples.concatenate(parts), times)
    return gyro, topic.name, (*bag.warnings, *([found] if found else []))


def read_stamps(bag: Bag, names: Sequence[str]) -> list[Ints]:
    """Return the stamps of topics whose messages have a header, in the order of recording.

    Raises
    ------
    RecordError
        If a message has none.
    """
    times: dict[str, list[Ints]] = {name: [] for name in names}
    stamps: dict[str, list[Ints]] = {name: [] for name in names}
    for name, log_time, messages, _ in bag.messages(times):
        times[name].append(log_time)
        stamps[name].append(stamps_ns(messages))
    found = []
    for name in names:
        stamp_ns, order = np.concatenate([_NONE, *stamps[name]]), _order(times[name])
        found.append(stamp_ns if order is None else stamp_ns[order])
    return found


def summary(path: str | Path) -> Summary:
    """Tell what a recording holds, without decoding it.

    Raises
    ------
    RecordError
        If the path holds no recording.
    """
    return summary_of(open_bag(Path(path)))


def summary_of(bag: Bag) -> Summary:
    """Tell what an open recording holds, without decoding it."""
    rows: list[TopicSummary] = []
    spans: list[int] = []
    for topic in bag.topics():
        span = bag.span(topic.name)
        first, last = span or (None, None)
        spans += span or []
        rows.append(TopicSummary(topic.name, topic.type, topic.count, first, last,
                                 mean_rate_hz(topic.count, span), topic.offered))
    return Summary(tuple(rows), {name: len(data) for name, data in bag.attachments.items()},
                   (max(spans) - min(spans)) / 1e9 if spans else 0.0,
                   sum(file.stat().st_size for file in bag.files), bag.warnings)


def _arrange_gyro(gyro: GyroSamples, times: list[Ints]) -> GyroSamples:
    order = _order(times)
    return gyro if order is None else GyroSamples(gyro.stamp_ns[order], gyro.rate[order])


def _order(times: list[Ints]) -> NDArray[np.intp] | None:
    """Return the order of recording, None where it is that of the file already."""
    log_time = np.concatenate([_NONE, *times])
    if (log_time[1:] >= log_time[:-1]).all():
        return None
    return np.argsort(log_time, kind='stable')
