# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `player`: publishes a recording again, no faster than its subscribers take it, then ends.

Without a choice of topics the results stay out: an estimator that listens makes new ones. The
topics keep their names, or, with `player.rename`, get those that the estimator listens to.

It publishes /clock, the time of the recording, for nodes with `use_sim_time`: it stands while the
player is paused, never runs ahead of a message that a subscriber keeps waiting, and goes back
where a loop begins again. With --json it writes how many messages of each topic it played, when
it ends.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
import heapq
import json
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from starcal_ros.config.parameter import ConfigError
from starcal_ros.config.scenario import PlayerConfig
from starcal_ros.core.units import NS
from starcal_ros.messages.cdr import RecordError
from starcal_ros.messages.topics import IMU, STARS, TOPICS
from starcal_ros.nodes.base import command_line, parameters, run_loop
from starcal_ros.nodes.base.flow_publisher import FlowPublisher, when_subscribed
from starcal_ros.nodes.base.pacing import Feed, Item, SimulatedClock
from starcal_ros.nodes.base.qos import message_type
from starcal_ros.recording.bag import Bag, RecordedTopic, described, open_bag
from starcal_ros.recording.names import CHOICES, suite_names

_RESULTS = tuple(topic.recorded for topic in TOPICS if topic.result)
_SENSORS = tuple(topic.name for topic in (IMU, *STARS))
_OF_ROS = ('/rosout', '/parameter_events', '/clock')


class Player(parameters.AnsweringNode):
    """Publish the messages of a bag in the rhythm of their log times."""

    def __init__(self, as_json: bool = False, **options: Any) -> None:
        super().__init__('player', **options)
        player = parameters.declare(self, 'player').player
        if not player.bag:
            raise ConfigError('player.bag: not given, needs an .mcap file or a rosbag2 directory')
        bag = open_bag(Path(player.bag))
        names = suite_names(bag.topics(), player.recorded_namespace, {
            topic: getattr(player, key) for topic, key in CHOICES.items()}) if (
                player.rename) else {}
        roles = names or _roles(bag.topics())
        # Sensors last: who listens to them has found the others.
        chosen = sorted(self._choose(bag, player, names), key=lambda topic: roles.get(
            topic.name, topic.name).endswith(_SENSORS))
        publishers = {topic.name: publisher for topic in chosen
                      if (publisher := self._publisher(topic, names.get(topic.name, topic.name)))}
        self._as_json, self._file, self._playing = as_json, player.bag, [*publishers.values()]
        start_ns = _start(bag, publishers, player)
        self._playback = SimulatedClock(start_ns, player.rate)
        self._feed = Feed(self, self._playback,
                          self._laps(bag, publishers, start_ns, player.loop))
        self._serve(player)
        played = {roles.get(name, name): publisher for name, publisher in publishers.items()
                  if name in names or not names}
        stars = next((form for form in STARS
                      if any(name.endswith(form.name) for name in played)), IMU)
        sensors = [publisher for name, publisher in played.items()
                   if name.endswith((IMU.name, stars.name))]
        when_subscribed(self, sensors or played.values(), player.wait_for_subscribers,
                        player.wait_for_nodes, self._playback.begin,
                        '; the recording has ' + ', '.join(
                            f'{topic.count} {topic.name}' for topic in bag.topics()))
        for text in bag.warnings:
            self.get_logger().warning(text)
        self.get_logger().info(f'playing {player.bag}: ' + ', '.join(
            name if name == publisher.topic else f'{name} as {publisher.topic}'
            for name, publisher in publishers.items()))

    @property
    def inputs(self) -> list[run_loop.Input]:
        """What the loop serves once it plays."""
        return [self._feed] if self._playback.begun else []

    @property
    def finished(self) -> bool:
        """True when the bag is at its end and all of it delivered."""
        return self._feed.finished

    @property
    def drained(self) -> bool:
        """True when all that was published is delivered, or can not be."""
        return self._feed.drained

    def close(self) -> None:
        """Deliver what was published."""
        self._feed.close()
        played = self._feed.published
        self.get_logger().info(f'{played.total()} messages played')
        if self._as_json:
            command_line.tell(json.dumps({'bag': self._file, 'played': {
                publisher.topic: played[publisher] for publisher in self._playing}}))

    def _choose(self, bag: Bag, player: PlayerConfig, names: dict[str, str]
                ) -> list[RecordedTopic]:
        """Return the topics to play: those wanted, by either name, or all but the results."""
        topics = {topic.name: topic for topic in bag.topics()}
        recorded = {name: each for each, name in names.items()}
        wanted = [recorded.get(name) or self.resolve_topic_name(name) for name in player.topics]
        for name in wanted:
            if name not in topics:
                raise ConfigError(f'player.topics: got {name}, {player.bag} has '
                                  f'{", ".join(topics) or "no topics"}')
        return [topic for name, topic in topics.items()
                if (name in wanted if wanted else not name.endswith(_RESULTS + _OF_ROS))]

    def _publisher(self, topic: RecordedTopic, name: str) -> FlowPublisher | None:
        kind = message_type(topic.type) if topic.encoding == 'cdr' else None
        if kind is None:
            self.get_logger().warning(f'{topic.name} is not played: {topic.type} is not installed')
            return None
        latched = 'transient_local' in described(topic.offered)
        return FlowPublisher(self, kind, name, latched=latched)

    def _laps(self, bag: Bag, publishers: dict[str, FlowPublisher], start_ns: int, loop: bool
              ) -> Iterator[Item]:
        """Yield the messages from the start on, in a loop again and again.

        Of the latched ones also those before the start, which whoever comes late would have.
        """
        while True:
            yield from (item for item in _items(bag, publishers)
                        if item[0] >= start_ns or item[1].latched)
            if not loop:
                return
            self.get_logger().info('beginning again')
            self._playback.begin()

    def _serve(self, player: PlayerConfig) -> None:
        self.create_service(Trigger, '~/pause', self._pause)
        self.create_service(Trigger, '~/resume', self._resume)
        if player.clock_hz > 0.0:
            self._clock_topic = self.create_publisher(Clock, '/clock', 1)
            run_loop.steady_timer(self, 1.0 / player.clock_hz, self._publish_clock)

    def _publish_clock(self) -> None:
        sec, nanosec = divmod(self._feed.now_ns, 10**9)
        self._clock_topic.publish(Clock(clock=Time(sec=sec, nanosec=nanosec)))

    def _pause(self, _: Any, response: Any) -> Any:
        self._feed.pause()
        response.success, response.message = True, 'paused'
        return response

    def _resume(self, _: Any, response: Any) -> Any:
        self._feed.resume()
        response.success, response.message = True, 'playing'
        return response


def _roles(topics: list[RecordedTopic]) -> dict[str, str]:
    """Return what topics that keep their names are to the suite, none where that is not clear."""
    try:
        return suite_names(topics, '', {})
    except ConfigError:
        return {}


def _start(bag: Bag, publishers: dict[str, FlowPublisher], player: PlayerConfig) -> int:
    """Return the log time at which to start [ns].

    What is latched may be older by far than the recording: the silence after it is left out.
    """
    spans = {name: span for name in publishers if (span := bag.span(name))}
    if not spans:
        raise RecordError(f'{player.bag} has no message to publish')
    first, last = min(begin for begin, _ in spans.values()), max(end for _, end in spans.values())
    start_ns = first + round(player.start_offset_s / NS)
    if start_ns > last:
        raise ConfigError(f'player.start_offset_s: got {player.start_offset_s}, {player.bag} '
                          f'lasts {(last - first) * NS:.3f} s')
    return max(start_ns, min((begin for name, (begin, _) in spans.items()
                              if not publishers[name].latched), default=first))


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
    return run_loop.run(Player, args, partial(Player, as_json=True))
