# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Star frames from the images of a recording, as a star tracker would have sent them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import hashlib

import numpy as np

from starcal_ros.config.scenario import Scenario
from starcal_ros.identification import recorded
from starcal_ros.imaging.centroids import BEYOND_FIT_PX
from starcal_ros.imaging.spot_meter import SpotMeter
from starcal_ros.measurements.message_source import MessageSource
from starcal_ros.measurements.samples import Frames
from starcal_ros.messages.cdr import Messages, RecordError
from starcal_ros.messages.cdr_compressed_image import decoder
from starcal_ros.messages.cdr_image import IMAGE_TYPE, ImageMessage

_DIGEST_BYTES = 16


def as_measured(scenario: Scenario) -> Scenario:
    """Return the scenario for frames that were measured: their sigmas hold the trail of a star."""
    return scenario.replace({'star_tracker.smear': False})


def as_still(frames: Frames) -> Frames:
    """Return measured frames with the sigmas that still images in a folder have.

    The camera alone hangs on the brightest stars, and so on what their fits know nothing of.
    """
    return replace(frames, sigma=np.hypot(frames.sigma, BEYOND_FIT_PX))


class ImageMeter:
    """Turns images in CDR into star frames, for `reader.read`; each image once.

    Its frames are those that the node ``centroid_extractor`` would have made of the images, and,
    after `identify`, ``star_identifier``. They are remembered: a recording may be read again.

    Parameters
    ----------
    scenario : Scenario
        Camera, exposure, and the group ``image``.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._meter = SpotMeter(scenario)
        self._frames: dict[bytes, Frames] = {}

    def __call__(self, messages: Messages, message_type: str = IMAGE_TYPE) -> Frames:
        """Return one frame a message, which are images of one type.

        Raises
        ------
        RecordError
            Where an image can not be measured.
        """
        found = []
        decode = decoder(message_type)
        for start, size in zip(messages.start.tolist(), messages.size.tolist()):
            message = messages.data[start:start + size].tobytes()
            digest = hashlib.blake2b(message, digest_size=_DIGEST_BYTES).digest()
            if digest not in self._frames:
                self._frames[digest] = self._measured(decode(message))
            found.append(self._frames[digest])
        return Frames.concatenate(found)

    def identify(self, source: MessageSource,
                 on_progress: Callable[[float], None] = lambda part: None) -> recorded.Numbered:
        """Identify the stars of a source whose frames are measured here.

        From then on the frames have the numbers.

        Raises
        ------
        ImportError, ValueError
            As `identification.recorded.identify`.
        """
        numbered = recorded.identify(source, self._scenario, on_progress)
        frames = numbered.frames
        known = {_key(frame): frame for frame in (
            frames[k:k + 1] for k in range(len(frames)))}
        self._frames = {digest: known.get(_key(frame), frame)
                        for digest, frame in self._frames.items()}
        return numbered

    def _measured(self, image: ImageMessage) -> Frames:
        stamp_ns, _, counts, pattern = image
        try:
            return self._meter.measure(counts, stamp_ns, pattern)[0]
        except ValueError as error:
            raise RecordError(f'image at {stamp_ns} ns: {error}') from None


def _key(frame: Frames) -> tuple[int, bytes]:
    return int(frame.stamp_ns[0]), frame.uv_raster.tobytes()
