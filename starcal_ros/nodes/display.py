# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `display`: what the estimator says as markers, annotations and numbers for other viewers.

For RViz, Foxglove, Lichtblick, PlotJuggler and the like; `starcal_ros.live.display` draws. It
publishes what the machine has the message types of. The estimator has one listener for all that
look on, and does not wait for them.
"""

from __future__ import annotations

from typing import Any

from rclpy.publisher import Publisher

from starcal_ros.live import display
from starcal_ros.messages import topics
from starcal_ros.messages.topics import Topic
from starcal_ros.nodes.base import run_loop
from starcal_ros.nodes.base.qos import LATCHED, message_type
from starcal_ros.nodes.base.results_listener import ResultsListener
from starcal_ros.nodes.base.ros_messages import DRAWINGS

_BEHIND = 100       # frames that wait to be drawn, on a busy machine


class Display(ResultsListener):
    """Publish what others draw: for each frame, as soon as its residuals are heard."""

    def __init__(self, **options: Any) -> None:
        super().__init__('display', _BEHIND, **options)
        self._offers: dict[Topic, Publisher] = {}
        for topic in display.DRAWN:
            kind = message_type(topic.type_name)
            if kind is None:
                package = topic.type_name.partition('/')[0]
                self.get_logger().info(f'{package} is not installed: no {topic.name}')
            else:
                self._offers[topic] = self.create_publisher(kind, topic.name, LATCHED)

    def _take(self, topic: Topic, message: Any) -> None:
        super()._take(topic, message)
        if topic in (topics.RESIDUALS, topics.DIAGNOSTICS):
            for drawn, publisher in self._offers.items():
                if topic is topics.RESIDUALS or drawn is topics.VALUES:
                    publisher.publish(display.DRAWN[drawn](DRAWINGS, self.seen))


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(Display, args)
