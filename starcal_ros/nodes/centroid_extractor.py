# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `centroid_extractor`: images in, unidentified centroids out."""

from __future__ import annotations

from typing import Any

from starcal_ros.imaging.spot_meter import SpotMeter
from starcal_ros.messages import cdr_pointcloud, topics
from starcal_ros.messages.cdr_compressed_image import decoder
from starcal_ros.messages.cdr_image import COMPRESSED_TYPE, ImageMessageError
from starcal_ros.nodes.base import run_loop
from starcal_ros.nodes.base.managed_node import ManagedNode
from starcal_ros.nodes.base.tally import Tally

_AT_ONCE = 4            # images: each has a megapixel and takes some 30 ms


class CentroidExtractor(ManagedNode):
    """Measure the spots of each image and publish them as one frame."""

    def __init__(self, **options: Any) -> None:
        super().__init__('centroid_extractor', 'camera', 'star_tracker', 'image',
                         'centroid_extractor', **options)
        self.start()

    def configure(self) -> None:
        """Prepare the measurement and its publisher."""
        self._meter = SpotMeter(self.scenario)
        self._spots = self.offer(topics.SPOTS)

    def activate(self) -> None:
        """Listen to the images, as soon as the spots have the listeners they must have."""
        self._tally = Tally(self, 'centroids', self.faults.counts)
        own = self.scenario.centroid_extractor
        self.when_heard(own.wait_for_subscribers, own.wait_for_nodes, self._listen)

    def _listen(self) -> None:
        images = topics.IMAGES
        if self.scenario.centroid_extractor.image_transport == 'compressed':
            images = images._replace(        # the name that image_transport gives it, remapped too
                name=f'{self.resolve_topic_name(images.name)}/compressed',
                type_name=COMPRESSED_TYPE)
        self._decode = decoder(images.type_name)
        self.listen(images, self._on_images, at_once=_AT_ONCE)

    def deactivate(self) -> None:
        """Say what was done."""
        self._tally.end()

    def _on_images(self, batch: list[bytes]) -> None:
        for message in batch:
            try:
                self._measure(message)
            except ImageMessageError as error:
                self.faults.add(error.kind, f'image dropped, {error}')
            except ValueError as error:
                self.faults.add('unsuitable image', f'image dropped, unsuitable: {error}')

    def _measure(self, message: bytes) -> None:
        stamp_ns, frame_id, image, pattern = self._decode(message)
        frame, left_out = self._meter.measure(image, stamp_ns, pattern)
        self._tally.newest_ns = stamp_ns
        self._tally.done.update({'images': 1, 'spots': len(frame.uv_raster),
                                 'spots left out': left_out})
        self._spots.publish(cdr_pointcloud.encode_centroids(frame, frame_id)[0])


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(CentroidExtractor, args)
