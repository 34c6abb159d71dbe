# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The metadata of rosbag2, version 9, as Jazzy and later write them.

They stand in metadata.yaml, and once more in each MCAP file: `ros2 bag info` reads the latter
where it is given a single file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import os
from typing import Any, NamedTuple

from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos
import yaml

from starcal_ros.files.documents import DocumentError, load_yaml

VERSION = 9
RECORD, KEY = 'rosbag2', 'serialized_metadata'
"""Where MCAP files have them."""


class Part(NamedTuple):
    """One file: its name, the first and last log time [ns] or none, its number of messages."""

    name: str
    span_ns: tuple[int, int] | None
    number: int


class Offer(NamedTuple):
    """One topic: its name, type and encoding, the offered QoS in YAML, its type's hash."""

    name: str
    type: str
    encoding: str
    qos: str
    type_hash: str


def information(parts: Sequence[Part], counts: Mapping[Offer, int],
                custom: Mapping[str, str], distribution: str = '') -> dict[str, Any]:
    """Return what is told of a recording in MCAP files, in the order of rosbag2.

    Parameters
    ----------
    parts : sequence of Part
        Its files.
    counts : dict of int
        The number of messages of each topic.
    custom : dict of str
        Texts of our own, by name.
    distribution : str
        That of ROS; '' for the one that is set up here.
    """
    spans = [part.span_ns for part in parts if part.span_ns]
    whole = (min(low for low, _ in spans), max(high for _, high in spans)) if spans else None
    return {
        'version': VERSION, 'storage_identifier': 'mcap', **_times(whole),
        'message_count': sum(part.number for part in parts),
        'topics_with_message_count': [
            {'topic_metadata': {
                'name': offer.name, 'type': offer.type, 'serialization_format': offer.encoding,
                'offered_qos_profiles': _profiles(offer.qos),
                'type_description_hash': offer.type_hash},
             'message_count': count} for offer, count in counts.items()],
        'compression_format': '', 'compression_mode': '',
        'relative_file_paths': [part.name for part in parts],
        'files': [{'path': part.name, **_times(part.span_ns), 'message_count': part.number}
                  for part in parts],
        'custom_data': dict(custom),
        'ros_distro': distribution or os.environ.get('ROS_DISTRO', '')}


def distribution(record: Mapping[str, str] | None) -> str:
    """Return the distribution of ROS that the record of an MCAP file names, '' for none."""
    try:
        found = load_yaml((record or {})[KEY])['ros_distro']
    except (DocumentError, LookupError, TypeError):
        return ''
    return found if isinstance(found, str) else ''


def dump(told: Mapping[str, Any]) -> str:
    """Return what `information` tells as YAML."""
    text: str = yaml.safe_dump(dict(told), sort_keys=False, allow_unicode=True, width=1000)
    return text


def dump_file(told: Mapping[str, Any]) -> str:
    """Return the text of metadata.yaml."""
    return dump({'rosbag2_bagfile_information': dict(told)})


def _times(span_ns: tuple[int, int] | None) -> dict[str, Any]:
    low, high = span_ns or (0, 0)
    return {'duration': {'nanoseconds': high - low},
            'starting_time': {'nanoseconds_since_epoch': low}}


def _profiles(qos: str) -> list[dict[str, Any]]:
    """Return the QoS of version 9, whatever version it was written in."""
    try:
        return [dict(each) for each in dump_qos_v9(parse_qos(load_yaml(qos) or []))]
    except (LookupError, TypeError, ValueError, AttributeError):
        return []
