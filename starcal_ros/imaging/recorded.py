# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Star frames from the images of a recording, as a star tracker would have sent them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from starcal_ros.camera import Detector
from starcal_ros.cdr import Messages, RecordError
from starcal_ros.cdr_image import decode_image
from starcal_ros.config_image import CentroidConfig
from starcal_ros.imaging.centroid import extract
from starcal_ros.measurements import Frames


def measure(detector: Detector, config: CentroidConfig = CentroidConfig()
            ) -> Callable[[Messages], Frames]:
    """Return what turns sensor_msgs/Image in CDR into star frames, for `record.read`.

    Stars have no number; their magnitude is -2.5 log10 of the counts, and those that are
    saturated, blended, cut or of another shape than the rest are left out.

    Parameters
    ----------
    detector : Detector
        Size that the images must have.
    config : CentroidConfig
        How stars are measured.
    """
    def frames(messages: Messages) -> Frames:
        stamps, uv, sigma, flux = [], [np.empty((0, 2))], [np.empty(0)], [np.empty(0)]
        for start, size in zip(messages.start.tolist(), messages.size.tolist()):
            stamp_ns, _, counts = decode_image(messages.data[start:start + size].tobytes())
            height, width = counts.shape
            if (width, height) != (detector.width, detector.height):
                raise RecordError(f'an image of {width} x {height} px; camera.width and '
                                  f'camera.height are {detector.width} x {detector.height}')
            found = extract(counts, config)
            clean = (found.flags == 0) & (found.flux > 0.0)
            stamps.append(stamp_ns)
            uv.append(found.uv_raster[clean])
            sigma.append(found.sigma[clean])
            flux.append(found.flux[clean])
        first = np.cumsum([0, *map(len, uv[1:])], dtype=np.int64)
        return Frames(np.array(stamps, np.int64), first, np.concatenate(uv),
                      np.concatenate(sigma), -2.5 * np.log10(np.concatenate(flux)),
                      np.zeros(first[-1], np.int64))
    return frames
