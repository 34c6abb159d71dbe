# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What has been heard of an estimator, from messages of rclpy or out of a recording.

The classes of both have the same fields, so one function takes either. A message that is not what
the estimator publishes is passed over.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starcal_ros.core.arrays import Array
from starcal_ros.filter.states import N_STATES, STATE_NAMES
from starcal_ros.messages import topics
from starcal_ros.messages.conventions import STATE_LAYOUT

STATE_SIZE = sum(size for _, size in STATE_LAYOUT)
"""Length of the data of ``starcal/state``."""
STAR_FIELDS = ('u', 'v', 'du', 'dv', 'nis', 'accepted')
"""What the views need of ``starcal/residuals``."""
SILENT_S = 3.0
"""Silence after which an estimator is taken to be gone [s]."""

_KINDS = {2: 'u1', 6: 'u4', 7: 'f4', 8: 'f8'}       # of sensor_msgs/PointField


@dataclass
class Seen:
    """What has been heard of an estimator; nothing yet, to begin with.

    Attributes
    ----------
    state : (273,) array, optional
        Data of ``starcal/state``.
    stars : structured (n,) array, optional
        ``starcal/residuals``, with STAR_FIELDS.
    stars_ns : int
        The stamp of their frame.
    size : (int, int), optional
        Width and height of the detector [px].
    pinhole : (float, float, float), optional
        Focal length and principal point, raster u and v, of the calibrated camera [px].
    level : int
        Of the diagnostics: 0 OK, 1 warning, 2 error, 3 stale.
    message : str
        The verdict.
    values : mapping
        The other diagnostics of the calibration, by their keys.
    inputs_message : str
        What the diagnostics say of the inputs.
    inputs : mapping
        Their diagnostics, by their keys.
    silent_s : float
        Time since the last diagnostics.
    """

    state: Array | None = None
    stars: NDArray[np.void] | None = None
    stars_ns: int = 0
    size: tuple[int, int] | None = None
    pinhole: tuple[float, float, float] | None = None
    level: int = 3
    message: str = ''
    values: Mapping[str, str] = field(default_factory=dict)
    inputs_message: str = ''
    inputs: Mapping[str, str] = field(default_factory=dict)
    silent_s: float = np.inf

    def take(self, topic: topics.Topic, message: Any) -> bool:
        """Take a message of one of `TOPICS`; return whether it is a verdict."""
        return bool(_TAKE[topic](self, message))

    @property
    def sigma(self) -> Array:
        """Standard deviations of the 16 states, in the filter's units; there must be a state."""
        assert self.state is not None
        return np.sqrt(self.state[1 + N_STATES::N_STATES + 1])

    def tolerances(self) -> list[float]:
        """Return the tolerance of each state, NaN where there is none."""
        return [self.number(f'tolerance_{name}') for name in STATE_NAMES]

    def number(self, key: str) -> float:
        """Return one of the values as a number, NaN where it is none."""
        return as_number(self.values.get(key, ''))


def as_number(text: str) -> float:
    """Return a text as a number, NaN where it is none."""
    try:
        return float(text)
    except ValueError:
        return float('nan')


def points(cloud: Any) -> NDArray[np.void]:
    """Return the points of a sensor_msgs/PointCloud2, by the names of its fields."""
    order = '>' if cloud.is_bigendian else '<'
    kind = np.dtype({'names': [item.name for item in cloud.fields],
                     'formats': [order + _KINDS[item.datatype] for item in cloud.fields],
                     'offsets': [item.offset for item in cloud.fields],
                     'itemsize': cloud.point_step})
    return np.frombuffer(cloud.data, kind, cloud.width * cloud.height)


def _take_state(seen: Seen, message: Any) -> None:
    data = np.array(message.data, np.float64)
    variances = data[1 + N_STATES::N_STATES + 1]
    if len(data) == STATE_SIZE and np.isfinite(data).all() and (variances >= 0.0).all():
        seen.state = data


def _take_stars(seen: Seen, message: Any) -> None:
    if {*STAR_FIELDS} <= {item.name for item in message.fields} and all(
            item.datatype in _KINDS for item in message.fields):
        seen.stars = points(message)
        seen.stars_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def _take_camera(seen: Seen, message: Any) -> None:
    seen.size = message.width, message.height
    f, _, cu, _, _, cv, *_ = (float(value) for value in message.k)
    seen.pinhole = (f, cu, cv) if f > 0.0 else None


def _take_diagnostics(seen: Seen, message: Any) -> bool:
    is_verdict = False
    for status in message.status:
        values = {item.key: item.value for item in status.values}
        if status.name.endswith('starcal: calibration'):
            level = status.level        # a byte of rclpy, a number of rosbags
            seen.level = level[0] if isinstance(level, bytes) else int(level)
            seen.message, seen.values, is_verdict = status.message, values, True
        elif status.name.endswith('starcal: inputs'):
            seen.inputs_message, seen.inputs = status.message, values
    return is_verdict


_TAKE: Mapping[topics.Topic, Callable[[Seen, Any], bool | None]] = {
    topics.STATE: _take_state, topics.RESIDUALS: _take_stars, topics.CAMERA: _take_camera,
    topics.DIAGNOSTICS: _take_diagnostics}
TOPICS = tuple(_TAKE)
"""What is listened to."""
