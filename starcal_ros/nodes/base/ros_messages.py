# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimates and truth in rclpy's message classes."""

from __future__ import annotations

from array import array

from starcal_ros.messages.contents import Contents, Types
from starcal_ros.messages.drawings import Drawings
from starcal_ros.nodes.base.qos import message_type

_TYPES = Types(message_type, lambda values: array(values.dtype.char, values.tobytes()))
CONTENTS, DRAWINGS = Contents(_TYPES), Drawings(_TYPES)
"""Make messages that rclpy can publish."""
