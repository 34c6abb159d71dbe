# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The groups that are named after a node: what only this node reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from starcal_ros.config.parameter import Spec

Strings = tuple[str, ...]


@dataclass(frozen=True)
class CentroidExtractorConfig:
    """The centroid extractor node."""

    image_transport: Annotated[str, Spec(
        'How the images come, by the names of image_transport: sensor_msgs/Image, or '
        'sensor_msgs/CompressedImage (JPEG or PNG) of the topic with /compressed behind its name',
        choices=('raw', 'compressed'))] = 'raw'
    wait_for_subscribers: Annotated[int, Spec(
        'Subscribers that star_tracker/spots must have before images are listened to', '', 0, 100)
    ] = 0
    wait_for_nodes: Annotated[Strings, Spec(
        'Nodes, by name, that must subscribe to star_tracker/spots before images are listened to; '
        'no other subscriber stands in for them')] = ()


@dataclass(frozen=True)
class StarIdentifierConfig:
    """The star identifier node."""

    limiting_magnitude: Annotated[float, Spec(
        'Faintest star that may be identified, Hp', 'mag', 2.0, 14.0)] = 8.0
    wait_for_subscribers: Annotated[int, Spec(
        'Subscribers that star_tracker/centroids must have before spots are listened to', '', 0,
        100)] = 0
    wait_for_nodes: Annotated[Strings, Spec(
        'Nodes, by name, that must subscribe to star_tracker/centroids before spots are listened '
        'to; no other subscriber stands in for them')] = ()


@dataclass(frozen=True)
class RecorderConfig:
    """The recorder node."""

    output: Annotated[str, Spec(
        'File to write, or directory where the recording is split; must not exist. A new one is '
        'for the next recording', changeable=True)] = 'run.mcap'
    topics: Annotated[Strings, Spec(
        'Topics to record; empty is all topics of the suite')] = ()
    max_bagfile_size: Annotated[int, Spec(
        'Length at which another file begins, as rosbag2 does; 0 is never', 'B', 0, 2**53)] = 0
    max_bagfile_duration: Annotated[int, Spec(
        'Time of the recording after which another file begins; 0 is never', 's', 0, 10**9)] = 0


@dataclass(frozen=True)
class ServeConfig:
    """The node that serves a page."""

    host: Annotated[str, Spec(
        'Address to listen on; 0.0.0.0 is open to everybody on the network')] = '127.0.0.1'
    port: Annotated[int, Spec('Port to listen on; 0 is any that is free', '', 0, 65535)] = 8806


@dataclass(frozen=True)
class PlayerConfig:
    """The player node."""

    bag: Annotated[str, Spec('Recording to publish again')] = ''
    rate: Annotated[float, Spec(
        'Recorded seconds a second; 0 is as fast as the subscribers take it', '', 0.0, 1e6)] = 1.0
    start_offset_s: Annotated[float, Spec(
        'Time of the recording to leave out at its beginning', 's', 0.0, 1e9)] = 0.0
    loop: Annotated[bool, Spec('Begin again at the end of the recording')] = False
    clock_hz: Annotated[float, Spec(
        'Rate at which /clock is published; 0 is not at all', 'Hz', 0.0, 1000.0)] = 40.0
    topics: Annotated[Strings, Spec(
        'Topics to publish; empty is all but the results (starcal/*)')] = ()
    rename: Annotated[bool, Spec(
        'Publish the sensor topics under the names of the suite, whatever theirs in the recording'
    )] = False
    recorded_namespace: Annotated[str, Spec(
        'With rename: namespace of the topics in the recording; empty is any')] = ''
    imu_topic: Annotated[str, Spec(
        'With rename: the gyro in the recording; empty is the only one')] = ''
    centroids_topic: Annotated[str, Spec(
        'With rename: the centroids in the recording; empty is the only ones')] = ''
    image_topic: Annotated[str, Spec(
        'With rename: the images in the recording; empty is the only ones')] = ''
    wait_for_subscribers: Annotated[int, Spec(
        'Subscribers that each sensor topic must have before the replay begins: the gyro, and '
        'centroids, or else spots, or else images', '', 0, 100)] = 0
    wait_for_nodes: Annotated[Strings, Spec(
        'Nodes, by name, that must subscribe to each of these topics before the replay begins; no '
        'other subscriber stands in for them')] = ()
