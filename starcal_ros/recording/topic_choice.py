# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which topics of a bag are the gyro, the stars and the images: named, or the only ones there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from starcal_ros.messages.cdr import RecordError
from starcal_ros.messages.cdr_image import COMPRESSED_TYPE, IMAGE_TYPE
from starcal_ros.messages.cdr_imu import IMU_TYPE
from starcal_ros.messages.cdr_pointcloud import CLOUD_TYPE
from starcal_ros.messages.topics import (ATTITUDE, CENTROIDS, IMAGES, IMU, RESIDUALS, SPOTS,
                                         TRUE_CENTROIDS)

if TYPE_CHECKING:
    from starcal_ros.recording.bag import Bag, RecordedTopic, Span

_NOT_OF_SENSORS = tuple(topic.recorded for topic in (
    ATTITUDE, RESIDUALS, SPOTS, TRUE_CENTROIDS))


class Role(NamedTuple):
    """What a topic can be: the option that names it, its own name in the suite, its type.

    And another type that is read as well, where there is no topic of the first.
    """

    option: str
    topic: str
    type: str
    other: str = ''

    def takes(self, type_: str) -> bool:
        """Tell whether messages of a type are read."""
        return type_ in (self.type, self.other or self.type)


GYRO = Role('--gyro-topic', IMU.recorded, IMU_TYPE)
FRAMES = Role('--frames-topic', CENTROIDS.recorded, CLOUD_TYPE)
IMAGE = Role('--image-topic', IMAGES.recorded, IMAGE_TYPE, COMPRESSED_TYPE)


class TopicChoice(NamedTuple):
    """The topics that a user names; None leaves one to be found."""

    gyro: str | None = None
    frames: str | None = None
    images: str | None = None


def candidates(topics: list[RecordedTopic], role: Role, given: str | None = None
               ) -> list[RecordedTopic]:
    """Return the topic of a name, or those that end with it, or those of its type."""
    if given is not None:
        return [topic for topic in topics if topic.name == '/' + given.lstrip('/')]
    return ([topic for topic in topics if topic.name == role.topic]
            or [topic for topic in topics if topic.name.endswith(role.topic)]
            or [topic for topic in of_type(topics, role) if topic.type == role.type]
            or of_type(topics, role))


def of_type(topics: list[RecordedTopic], role: Role) -> list[RecordedTopic]:
    """Return the topics that may come from such a sensor, by their type."""
    return [topic for topic in topics
            if role.takes(topic.type) and not topic.name.endswith(_NOT_OF_SENSORS)]


def choose(bag: Bag, role: Role, path: Path, given: str | None = None) -> RecordedTopic:
    """Find the only candidate for a role, or the topic that a user has given for it.

    Raises
    ------
    RecordError
        Where there is none, or several, or it is of another type; with what there is.
    """
    topics = bag.topics()
    found = candidates(topics, role, given)
    if len(found) > 1:
        raise RecordError(f'{path} has several topics {role.topic}: {_listed(bag, found)}; '
                          f'{role.option} chooses one')
    if not found and given is not None and (others := of_type(topics, role)):
        raise RecordError(f'{path} has no topic {given}; for {role.option} it has '
                          f'{_listed(bag, others)}')
    if not found:
        listed = ', '.join(topic.name for topic in topics) or 'no topics'
        raise RecordError(f'{path} has no topic {given or role.topic}; it has {listed}')
    topic, = found
    if topic.type and not role.takes(topic.type):   # none: without a schema
        raise RecordError(f'{path}: {topic.name} is of type {topic.type or "unknown"}, '
                          f'not {role.type}' + (f' or {role.other}' if role.other else ''))
    if topic.encoding != 'cdr':
        raise RecordError(f"{path}: {topic.name} has encoding '{topic.encoding}', not 'cdr'")
    return topic


def notice(topics: list[RecordedTopic], role: Role, chosen: RecordedTopic) -> str | None:
    """Return what to say of a topic that was found under another name, beside others or alone."""
    if chosen.name == role.topic:
        return None
    others = [topic.name for topic in of_type(topics, role) if topic.name != chosen.name]
    if others:
        return f'{chosen.name} is read, not {", ".join(others)}: {role.option} chooses another'
    if not chosen.name.endswith(role.topic):
        return f'{chosen.name} is taken for {role.topic}'
    return None


def mean_rate_hz(count: int, span: Span | None) -> float:
    """Return the mean rate of messages that were recorded in a time, NaN below two messages."""
    span_ns = span.last_ns - span.first_ns if span else 0
    return (count - 1) / span_ns * 1e9 if span_ns > 0 else np.nan


def _listed(bag: Bag, topics: list[RecordedTopic]) -> str:
    def rate(topic: RecordedTopic) -> str:
        value = mean_rate_hz(topic.count, bag.span(topic.name))
        return f', {value:.2f} Hz' if value == value else ''
    return ', '.join(f'{topic.name} ({topic.type or "unknown type"}, {topic.count} messages'
                     f'{rate(topic)})' for topic in topics)
