# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Which topics of a recording are those of the suite, under whatever name."""

from __future__ import annotations

from collections.abc import Mapping

from starcal_ros.config.parameter import ConfigError
from starcal_ros.messages.topics import CENTROIDS, IMAGES, IMU, TOPICS, Topic
from starcal_ros.recording.bag import RecordedTopic
from starcal_ros.recording.topic_choice import Role, candidates

CHOICES = {IMU: 'imu_topic', CENTROIDS: 'centroids_topic', IMAGES: 'image_topic'}
"""The topics that may have any name, and the parameter of the player that has it."""


def suite_names(topics: list[RecordedTopic], namespace: str, given: Mapping[Topic, str]
                ) -> dict[str, str]:
    """Return the suite's name of each topic of a recording that it has one for.

    A topic is the one that is given, or else that of its name, or the only one that ends so (in
    a namespace), or, for gyro, centroids and images, the only one of its type (remapped).

    Parameters
    ----------
    topics : list of RecordedTopic
        Those of the recording.
    namespace : str
        Where to look; '' is everywhere.
    given : dict of str
        Names in the recording, by topics of the suite; '' is not given.

    Returns
    -------
    names : dict of str
        Relative names, by those in the recording.

    Raises
    ------
    ConfigError
        Where the recording has no topic that is given, none in the namespace, or several to
        choose from.
    """
    space = f'/{namespace.strip("/")}/' if namespace.strip('/') else '/'
    inside = [topic for topic in topics if topic.name.startswith(space)]
    if not inside:
        raise ConfigError(f'player.recorded_namespace: got {namespace}, {_holds(topics)}')
    names: dict[str, str] = {}
    for topic in TOPICS:
        if topic.result:
            continue
        if name := given.get(topic):
            name = '/' + name.lstrip('/')
            if name not in (each.name for each in topics):
                raise ConfigError(f'player.{CHOICES[topic]}: got {name}, {_holds(topics)}')
            names[name] = topic.name
            continue
        role = Role('', space + topic.name, topic.type_name)
        found = [each for each in candidates(inside, role)
                 if topic in CHOICES or each.name.endswith('/' + topic.name)]
        if len(found) > 1 and topic in CHOICES and (topic is not IMAGES or len(names) < 2):
            raise ConfigError(
                f'player.{CHOICES[topic]}: needs one of {", ".join(e.name for e in found)}, '
                f'which may all be {topic.name}; or player.recorded_namespace')
        if len(found) == 1:
            names.setdefault(found[0].name, topic.name)
    return names


def _holds(topics: list[RecordedTopic]) -> str:
    return f'the recording has {", ".join(topic.name for topic in topics) or "no topics"}'
