# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A simulated recording, written straight to a file: what the nodes publish, without them."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path

import numpy as np

from starcal_ros.config import parameter_file
from starcal_ros.config.models import detector, intrinsics
from starcal_ros.config.scenario import Scenario
from starcal_ros.core.arrays import Ints
from starcal_ros.files.output import whole
from starcal_ros.messages import topics
from starcal_ros.messages.cdr_image import IMAGE_TYPE, encode_image
from starcal_ros.messages.cdr_imu import encode_quaternions
from starcal_ros.messages.contents import Contents
from starcal_ros.messages.conventions import GYRO_FRAME, INERTIAL_FRAME, OPTICAL_FRAME
from starcal_ros.recording.qos import LATCHED
from starcal_ros.recording.reader import CONFIG_ATTACHMENT, TRUTH_ATTACHMENT
from starcal_ros.recording.writer import (TYPES, Batch, Writer, centroids_batch, imu_batch,
                                          serialize)
from starcal_ros.simulation import sensors
from starcal_ros.simulation.render import ImageSimulator
from starcal_ros.simulation.truth import VECTOR_LABEL, Truth

CONTENTS = Contents(TYPES)
"""Makes messages that `serialize` takes."""

_BATCH_S = 60.0             # simulated seconds written at once
_CHUNK_S = 30               # nobody reads it before it is whole
_IMAGES_BATCH_S = 2.0       # the same, where a frame takes megabytes


def simulate(scenario: Scenario, path: str | Path, overwrite: bool = False,
             on_progress: Callable[[float], None] | None = None) -> None:
    """Write the recording of a scenario: sensors, nominal camera, truth, configuration.

    With ``simulation.images`` the star tracker delivers images, its centroids being truth, as the
    node does.

    Parameters
    ----------
    scenario : Scenario
        With its truth.
    path : path
        The .mcap file to make.
    overwrite : bool
        Replace a file that exists.
    on_progress : callable, optional
        Called with the part done, 0 to 1.

    Raises
    ------
    OutputError
        Where the file exists, or can not be written; then there is none.
    ValueError
        Where the catalogue does not reach down to a limiting magnitude.
    """
    truth = Truth.from_scenario(scenario)
    gyro, tracker = sensors.gyro(scenario), sensors.star_tracker(scenario)
    variance = gyro.rate_variance
    renderer = sensors.images(scenario) if scenario.simulation.images else None
    centroids = topics.TRUE_CENTROIDS if renderer else topics.CENTROIDS
    batch_s = _IMAGES_BATCH_S if renderer else _BATCH_S
    with (whole(path, overwrite) as draft,
          Writer(draft, overwrite=True, chunk_s=_CHUNK_S) as writer):
        writer.attach(CONFIG_ATTACHMENT, parameter_file.dump(scenario).encode(),
                      'application/yaml')
        writer.attach(TRUTH_ATTACHMENT, json.dumps(truth.as_dict(), indent=1).encode(),
                      'application/json')
        writer.write_batches(*_latched(scenario, truth))
        batches = max(1, int(np.ceil(scenario.simulation.duration_s / batch_s)))
        for done in range(1, batches + 1):
            samples = gyro.next(gyro.count * done // batches - gyro.next_index)
            frames = tracker.next(tracker.count * done // batches - tracker.next_index)
            writer.write_batches(imu_batch(topics.IMU.recorded, samples, GYRO_FRAME, variance),
                                 *([_images(frames.stamp_ns, renderer)] if renderer else []),
                                 centroids_batch(centroids.recorded, frames),
                                 _attitude(frames.stamp_ns, truth))
            if on_progress:
                on_progress(done / batches)


def _latched(scenario: Scenario, truth: Truth) -> list[Batch]:
    start, values = truth.motion.start_ns, truth.vector()
    camera = CONTENTS.camera_info(start, intrinsics(scenario.camera), detector(scenario.camera),
                                  OPTICAL_FRAME)
    parameters = CONTENTS.labelled([(VECTOR_LABEL, len(values))], values)
    return [Batch(topic.recorded, topic.type_name, np.array([start]),
                  [serialize(topic.type_name, message)], (LATCHED,))
            for topic, message in ((topics.NOMINAL_CAMERA, camera),
                                   (topics.TRUE_PARAMETERS, parameters))]


def _images(stamps_ns: Ints, renderer: ImageSimulator) -> Batch:
    return Batch(topics.IMAGES.recorded, IMAGE_TYPE, stamps_ns, [
        encode_image(stamp_ns, renderer.image(stamp_ns)) for stamp_ns in stamps_ns.tolist()])


def _attitude(stamps_ns: Ints, truth: Truth) -> Batch:
    return Batch(topics.TRUE_ATTITUDE.recorded, topics.TRUE_ATTITUDE.type_name, stamps_ns,
                 encode_quaternions(stamps_ns, truth.motion.attitude(stamps_ns), INERTIAL_FRAME))
