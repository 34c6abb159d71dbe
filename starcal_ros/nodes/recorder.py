# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `recorder`: writes the topics of the suite to one MCAP file, without loss at any speed.

The log time of a message is its stamp, not the time of its arrival: a run that was simulated at
twenty times its speed is then played back at its own. The stamp stands in the header, or inside
(`nodes.base.stamps`). A message without one, or a status with that of a clock that is an hour from
the run's, gets the newest stamp that came from the same source. A stamp that goes backward gets
the newest of its topic, so each topic keeps its order of arrival; so does one that is an hour
ahead, until the next one is, too.

A topic is subscribed to as soon as somebody publishes it, so that the graph shows no others.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
import json
from typing import Any

import numpy as np
from rclpy.qos import DurabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray

from starcal_ros.config import parameter_file
from starcal_ros.messages.topics import DIAGNOSTICS, TOPICS, TRUE_PARAMETERS, Topic
from starcal_ros.nodes.base import run_loop
from starcal_ros.nodes.base.managed_node import ManagedNode
from starcal_ros.nodes.base.qos import message_type, offered_qos
from starcal_ros.nodes.base.stamps import FAR_NS, is_of_ros, stamp_reader
from starcal_ros.recording.qos import Qos
from starcal_ros.recording.reader import CONFIG_ATTACHMENT, TRUTH_ATTACHMENT
from starcal_ros.recording.writer import Batch, Writer
from starcal_ros.simulation.truth import VECTOR_SIZE, from_vector

_FLUSH_S = 1.0                  # a killed recorder loses no more than this
_FLUSH_BYTES = 16 << 20
_SEARCH_S = 0.05
_LATEST = 100                   # latched messages of a publisher that are told from new ones


@dataclass
class _Channel:
    """One recorded topic and its messages since the last flush."""

    type_name: str
    latched: bool
    stamp_ns: Callable[[bytes], int | None]     # of a message
    of_ros: bool            # its stamps are ROS time, not those of the sensors
    source: str             # topics of one source run by one clock
    qos: tuple[Qos, ...] = ()
    newest_ns: int = 0
    is_ahead: bool = False          # the last stamp, far, and not believed
    log_times_ns: list[int | None] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)
    count: int = 0
    latest: deque[bytes] = field(default_factory=lambda: deque(maxlen=_LATEST))
    known: set[bytes] = field(default_factory=set)      # latched, and recorded before a pause

    def log_time_ns(self, stamp_ns: int) -> int:
        """Return the log time of the next message."""
        far = self.newest_ns > 0 and stamp_ns > self.newest_ns + FAR_NS
        if not far or self.is_ahead:
            self.newest_ns = max(self.newest_ns, stamp_ns)
        self.is_ahead = far and not self.is_ahead
        return self.newest_ns


class Recorder(ManagedNode):
    """Subscribe to the topics and write what comes, once a second, in the order of the stamps."""

    def __init__(self, **options: Any) -> None:
        super().__init__('recorder', 'recorder', **options)
        self._channels: dict[str, _Channel] = {}
        self.start()

    def configure(self) -> None:
        """Make the file."""
        options = self.scenario.recorder
        self._channels.clear()
        self._newest_ns: dict[str, int] = {}        # by source
        self._n_bytes = 0
        self._known = {self.resolve_topic_name(topic.name): topic for topic in TOPICS}
        self._wanted = [self.resolve_topic_name(name) for name in options.topics] or [*self._known]
        self._writer = Writer(options.output)
        self._writer.attach(CONFIG_ATTACHMENT, parameter_file.dump(self.scenario).encode(),
                            'application/yaml')

    def activate(self) -> None:
        """Subscribe to the topics that are published, and to the others when they are."""
        self._searched = [*self._wanted]
        self._search()
        self.repeat(_FLUSH_S, self._flush)
        self.repeat(_SEARCH_S, self._search)
        self.get_logger().info(f'recording to {self._writer.path}')

    def deactivate(self) -> None:
        """Write what has arrived."""
        self._flush()

    def cleanup(self) -> None:
        """Finish the file."""
        self._flush(self.get_clock().now().nanoseconds)
        self._attach_truth()
        self._writer.close()
        counts = {name: channel.count for name, channel in self._channels.items()}
        self.get_logger().info(f'{sum(counts.values())} messages recorded to {self._writer.path}: '
                               + ', '.join(f'{name} {n}' for name, n in counts.items() if n))

    def _attach_truth(self) -> None:
        channel = self._channels.get(self.resolve_topic_name(TRUE_PARAMETERS.name))
        if channel and channel.latest:
            values = np.array(deserialize_message(channel.latest[-1], Float64MultiArray).data)
            if len(values) != VECTOR_SIZE:
                return
            text = json.dumps(from_vector(values), indent=1)
            self._writer.attach(TRUTH_ATTACHMENT, text.encode(), 'application/json')

    def _subscribe(self, topic: Topic, source: str = '') -> None:
        name, kind = topic.name, message_type(topic.type_name)
        if kind is None:
            self.get_logger().debug(f'{name} is not recorded: {topic.type_name} is not installed')
            return
        channel = self._channels.setdefault(name, _Channel(
            topic.type_name, topic.latched, stamp_reader(kind),
            is_of_ros(kind) or name.endswith(DIAGNOSTICS.name), source or name.rsplit('/', 1)[0]))
        channel.known = set(channel.latest) if topic.latched else set()
        self.listen(topic, lambda batch: self._take(channel, batch))

    def _search(self) -> None:
        """Subscribe to the topics that have a publisher by now."""
        for name in [name for name in self._searched if self.count_publishers(name)]:
            if topic := self._known.get(name):
                self._subscribe(topic._replace(name=name), 'estimator' if topic.result else '')
            elif types := dict(self.get_topic_names_and_types()).get(name):
                latched = any(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                              for info in self.get_publishers_info_by_topic(name))
                self._subscribe(Topic(name, types[0], latched))
            else:
                continue        # its type is not known yet
            self._searched.remove(name)

    def _take(self, channel: _Channel, batch: list[bytes]) -> None:
        if channel.known:           # a latched message comes once more to who subscribes again
            batch, given = [message for message in batch if message not in channel.known], batch
            channel.known.difference_update(given)
        newest_ns = self._newest_ns.get(channel.source)
        for stamp_ns in map(channel.stamp_ns, batch):
            if channel.of_ros or stamp_ns is None:
                log_time = None if newest_ns is None else _near(stamp_ns, newest_ns)
            else:
                log_time = channel.log_time_ns(stamp_ns)
                newest_ns = max(newest_ns or 0, log_time)
            channel.log_times_ns.append(log_time)
        if newest_ns is not None:
            self._newest_ns[channel.source] = newest_ns
        channel.messages += batch
        channel.latest.extend(batch[-_LATEST:])
        channel.count += len(batch)
        self._n_bytes += sum(map(len, batch))
        if self._n_bytes > _FLUSH_BYTES:
            self._flush()

    def _flush(self, otherwise_ns: int | None = None) -> None:
        """Write the messages since the last time, sorted by their log times.

        What came before the first stamp of its source waits for one, of any source.
        """
        first_ns = min((t for channel in self._channels.values()
                        for t in channel.log_times_ns if t is not None), default=otherwise_ns)
        batches = []
        for name, channel in self._channels.items():
            if not channel.messages or (None in channel.log_times_ns and first_ns is None):
                continue
            channel.qos = channel.qos or offered_qos(self, name, channel.latched)
            log_time = [_near(channel.stamp_ns(message), first_ns) if t is None else t
                        for t, message in zip(channel.log_times_ns, channel.messages)]
            batches.append(Batch(name, channel.type_name, np.array(log_time, np.int64),
                                 channel.messages, channel.qos))
            channel.messages, channel.log_times_ns = [], []
        self._n_bytes = 0
        if batches:
            self._writer.write_batches(*batches)
            self._writer.flush()


def _near(stamp_ns: int | None, newest_ns: int) -> int:
    """Return a stamp, or that of the run where there is none or it is of another clock."""
    far = stamp_ns is None or abs(stamp_ns - newest_ns) > FAR_NS
    return newest_ns if far else stamp_ns


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(Recorder, args)
