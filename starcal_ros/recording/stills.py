# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""The images of a recording of which nothing else is known, as still images."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timezone
from os import PathLike
from pathlib import Path

from starcal_ros.imaging.picture import Picture, Plane
from starcal_ros.imaging.pixels import Scale
from starcal_ros.messages.cdr import RecordError
from starcal_ros.messages.cdr_compressed_image import decoder
from starcal_ros.recording.bag import open_bag
from starcal_ros.recording.reader import CONFIG_ATTACHMENT
from starcal_ros.recording.topic_choice import FRAMES, GYRO, IMAGE, candidates, choose


def are_all(path: str | PathLike[str]) -> bool:
    """Tell whether a recording has images and nothing else to calibrate with.

    Neither centroids nor gyro readings, nor the configuration of a camera.

    Raises
    ------
    RecordError
        Where it is no recording.
    """
    bag = open_bag(Path(path))
    topics = bag.topics()
    return (CONFIG_ATTACHMENT not in bag.attachments and bool(candidates(topics, IMAGE))
            and not candidates(topics, FRAMES) and not candidates(topics, GYRO))


def pictures(path: str | PathLike[str]) -> Iterator[Picture | str]:
    """Yield the images in the order of their recording, or what is wrong with one.

    Raises
    ------
    RecordError
        Where it is no recording, or has several topics of images.
    """
    bag = open_bag(Path(path))
    topic = choose(bag, IMAGE, Path(path))
    decode = decoder(topic.type)
    for stretch in bag.in_order([topic.name]):
        for _, _, messages in stretch.messages:
            for start, size in zip(messages.start.tolist(), messages.size.tolist()):
                try:
                    stamp_ns, _, pixels, pattern = decode(
                        messages.data[start:start + size].tobytes())
                    taken = datetime.fromtimestamp(stamp_ns // 1000 / 1e6, timezone.utc)
                    yield Picture.of(Plane(pixels, Scale.of(pixels.dtype), taken, pattern))
                except (RecordError, ValueError, OverflowError, OSError) as error:
                    yield f'image: {error}'
