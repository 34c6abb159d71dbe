# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Compressed images as other programs write them."""

from io import BytesIO

from PIL import Image
import numpy as np
from rosbags.typesys import Stores, get_typestore

from starcal_ros.messages.cdr_image import COMPRESSED_TYPE


def compressed(pixels, kind, described, stamp_ns=0, frame_id='star_tracker_optical'):
    """Return a sensor_msgs/CompressedImage as rosbags serialises it."""
    store, stream = get_typestore(Stores.ROS2_JAZZY), BytesIO()
    Image.fromarray(pixels).save(stream, kind)
    header = store.types['std_msgs/msg/Header'](store.types['builtin_interfaces/msg/Time'](
        *divmod(stamp_ns, 10**9)), frame_id)
    message = store.types[COMPRESSED_TYPE](
        header, described, np.frombuffer(stream.getvalue(), np.uint8))
    return bytes(store.serialize_cdr(message, COMPRESSED_TYPE))
