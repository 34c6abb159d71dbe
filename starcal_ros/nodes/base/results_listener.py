# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""A node that hears what an estimator says, for who looks on.

It subscribes to results alone, never to a sensor, and keeps the newest message of each: nobody
waits for it.
"""

from __future__ import annotations

from functools import partial
import time
from typing import Any

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from starcal_ros.live import heard
from starcal_ros.messages.topics import Topic
from starcal_ros.nodes.base.parameters import AnsweringNode
from starcal_ros.nodes.base.qos import message_type

_PASSING = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


class ResultsListener(AnsweringNode):
    """Keep what an estimator says.

    Parameters
    ----------
    name : str
        Of the node.
    behind : int
        Messages of a topic that may wait; with one, what is newest is shown.
    options
        Of the node.
    """

    def __init__(self, name: str, behind: int = 1, **options: Any) -> None:
        super().__init__(name, **options)
        latched = QoSProfile(depth=behind, reliability=ReliabilityPolicy.RELIABLE,
                             durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._seen, self._heard_s = heard.Seen(), -np.inf
        for topic in heard.TOPICS:
            self.create_subscription(
                message_type(topic.type_name), topic.name, partial(self._take, topic),
                latched if topic.latched else _PASSING)

    @property
    def seen(self) -> heard.Seen:
        """What has been heard by now."""
        self._seen.silent_s = time.monotonic() - self._heard_s
        return self._seen

    def _take(self, topic: Topic, message: Any) -> None:
        if self._seen.take(topic, message):
            self._heard_s = time.monotonic()
