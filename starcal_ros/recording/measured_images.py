# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Star frames from the images of a recording, as a star tracker would have sent them."""

from __future__ import annotations

from collections.abc import Callable

from starcal_ros.config.scenario import Scenario
from starcal_ros.imaging.spot_meter import SpotMeter
from starcal_ros.measurements.samples import Frames
from starcal_ros.messages.cdr import Messages, RecordError
from starcal_ros.messages.cdr_image import decode_image


def as_measured(scenario: Scenario) -> Scenario:
    """Return the scenario for frames that were measured: their sigmas hold the trail of a star."""
    return scenario.replace({'star_tracker.smear': False})


def measure(scenario: Scenario) -> Callable[[Messages], Frames]:
    """Return what turns sensor_msgs/Image in CDR into star frames, for `reader.read`.

    Its frames are those that the node ``centroid_extractor`` would have made of the images.
    """
    meter = SpotMeter(scenario)

    def frames(messages: Messages) -> Frames:
        found = []
        for start, size in zip(messages.start.tolist(), messages.size.tolist()):
            stamp_ns, _, counts, pattern = decode_image(
                messages.data[start:start + size].tobytes())
            try:
                found.append(meter.measure(counts, stamp_ns, pattern)[0])
            except ValueError as error:
                raise RecordError(f'image at {stamp_ns} ns: {error}') from None
        return Frames.concatenate(found)
    return frames
