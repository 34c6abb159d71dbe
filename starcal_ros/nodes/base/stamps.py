# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Where a message has its stamp, and which stamp a status gets.

Most types begin with a header. A transform has its header in the first element of an array, and
`starcal/state` its stamp in the data, under a label, in seconds; a float64 of these has 0.24 us,
so it is read to the microsecond.
"""

from __future__ import annotations

from collections.abc import Callable
import struct

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray

from starcal_ros.messages.conventions import STATE_LAYOUT

FAR_NS = 3600 * 10**9
"""Stamps further apart are those of different clocks, such as that of a simulated run."""

_FIRST, _IN_ARRAY = 4, 8        # behind the encapsulation, and the number of elements
_LITTLE, _BIG = struct.Struct('<iI'), struct.Struct('>iI')
_TIME = 'builtin_interfaces/Time'
_STAMPED = ('std_msgs/Header', _TIME)
_ARRAYS = ('sequence<geometry_msgs/TransformStamped>',)
_SECONDS = 2.0**31              # of builtin_interfaces/Time, before which all stamps are


def stamp_reader(kind: type) -> Callable[[bytes], int | None]:
    """Return a function that gives the stamp of a message of a type in CDR [ns], if it has one."""
    first = _first(kind)
    if first in _STAMPED:
        return lambda message: _at(message, _FIRST)
    if first in _ARRAYS:
        return lambda message: _at(message, _IN_ARRAY) if any(message[4:8]) else None
    return _labelled if kind is Float64MultiArray else lambda message: None


def is_of_ros(kind: type) -> bool:
    """Tell whether a type, as that of /rosout, begins with a bare time: that of ROS."""
    return _first(kind) == _TIME


def _first(kind: type) -> str:
    fields: dict[str, str] = kind.get_fields_and_field_types()      # type: ignore[attr-defined]
    return next(iter(fields.values()), '')


def _at(message: bytes, offset: int) -> int:
    # The second byte of the encapsulation tells the byte order.
    sec, nanosec = (_LITTLE if message[1] & 1 else _BIG).unpack_from(message, offset)
    return int(sec * 10**9 + nanosec)


def _labelled(message: bytes) -> int | None:
    array = deserialize_message(message, Float64MultiArray)
    if not array.data or [part.label for part in array.layout.dim[:1]] != [STATE_LAYOUT[0][0]]:
        return None
    if not 0.0 <= array.data[0] < _SECONDS:     # as the NaN of a display that knows no frame yet
        return None
    return round(array.data[0] * 1e6) * 1000


def status_stamp(node: Node, newest_ns: int) -> Time:
    """Return the stamp of a status: ROS time, or that of a run which has another clock.

    Parameters
    ----------
    node : Node
        Whose status.
    newest_ns : int
        Newest stamp of the messages that the status tells of, 0 where there is none.
    """
    now_ns = node.get_clock().now().nanoseconds
    far = newest_ns > 0 and abs(now_ns - newest_ns) > FAR_NS
    sec, nanosec = divmod(newest_ns if far else now_ns, 10**9)
    return Time(sec=sec, nanosec=nanosec)
