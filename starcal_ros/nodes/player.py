# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `player`: publishes a recording again, no faster than its subscribers take it, then ends.

Without a choice of topics the results stay out: an estimator that listens makes new ones.
"""

from __future__ import annotations

import heapq
import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from rclpy.node import Node

from starcal_ros.bag import Bag, Topic, open_bag
from starcal_ros.cdr import RecordError
from starcal_ros.config import PlayerConfig
from starcal_ros.parameter import ConfigError
from starcal_ros.nodes import parameters, runtime
from starcal_ros.nodes.flow import FlowPublisher, when_subscribed
from starcal_ros.nodes.pacing import Feed, Item, SimulatedClock
from starcal_ros.nodes.topics import SENSORS, TOPICS, message_type

_RESULTS = tuple('/' + topic.name.lstrip('/') for topic in TOPICS if topic.result)
_OF_ROS = ('/rosout', '/parameter_events', '/clock')


class Player(Node):
    """Publish the messages of a bag in the rhythm of their log times."""

    def __init__(self) -> None:
        super().__init__('player')
        player = parameters.declare(self, 'player').player
        if not player.bag:
            raise ConfigError('player.bag: not given, needs an .mcap file or a rosbag2 directory')
        bag = open_bag(Path(player.bag))
        publishers = {topic.name: publisher for topic in self._choose(bag, player)
                      if (publisher := self._publisher(topic))}
        items = _items(bag, publishers)
        first = next(items, None)
        if first is None:
            raise RecordError(f'{player.bag} has no message to publish')
        clock = SimulatedClock(first[0], player.rate)
        self._feed = Feed(self, clock, chain([first], items))
        sensors = [publisher for name, publisher in publishers.items() if name.endswith(SENSORS)]
        when_subscribed(self, sensors or publishers.values(), player.wait_for_subscribers,
                        clock.begin)
        for text in bag.warnings:
            self.get_logger().warning(text)
        self.get_logger().info(f'playing {", ".join(publishers)} of {player.bag}')

    @property
    def finished(self) -> bool:
        """True when the bag is at its end and all of it delivered."""
        return self._feed.finished

    def close(self) -> None:
        """Deliver what was published."""
        self._feed.close()
        self.get_logger().info(f'{self._feed.published} messages played')

    def _choose(self, bag: Bag, player: PlayerConfig) -> list[Topic]:
        topics = {topic.name: topic for topic in bag.topics()}
        wanted = [self.resolve_topic_name(name) for name in player.topics]
        for name in wanted:
            if name not in topics:
                raise ConfigError(f'player.topics: got {name}, {player.bag} has '
                                  f'{", ".join(topics) or "no topics"}')
        return [topic for name, topic in topics.items()
                if (name in wanted if wanted else not name.endswith(_RESULTS + _OF_ROS))]

    def _publisher(self, topic: Topic) -> FlowPublisher | None:
        kind = message_type(topic.type) if topic.encoding == 'cdr' else None
        if kind is None:
            self.get_logger().warning(f'{topic.name} is not played: {topic.type} is not installed')
            return None
        return FlowPublisher(self, kind, topic.name, latched='transient_local' in topic.qos)


def _items(bag: Bag, publishers: dict[str, FlowPublisher]) -> Iterator[Item]:
    """Return all messages in the order of their log times."""
    def of(name: str) -> Iterator[Item]:
        for _, log_time, messages, _ in bag.messages([name]):
            for t, start, size in zip(log_time.tolist(), messages.start.tolist(),
                                      messages.size.tolist()):
                yield t, publishers[name], messages.data[start:start + size].tobytes()
    return heapq.merge(*map(of, publishers), key=lambda item: item[0])


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return runtime.run(Player, args)


if __name__ == '__main__':
    sys.exit(main())
