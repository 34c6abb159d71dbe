# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Node `recorder`: writes the topics of the suite to MCAP, without loss at any speed.

The log time of a message is its stamp, not the time of its arrival: a run that was simulated at
twenty times its speed is then played back at its own. The stamp stands in the header, or inside
(`nodes.base.stamps`). A message without one, or a status with that of a clock that is an hour from
the run's, gets the newest stamp that came from the same source. A stamp that is late gets the
newest of its topic, so each topic keeps its order of arrival; so does one that is an hour ahead or
a second back, until the next one is, too. Where clocks are set back, the log times go on
(`recorder_channel`).

A topic is subscribed to as soon as somebody publishes it, so that the graph shows no others.

What arrives is taken within 10 ms, and is in the file half a second of its own time later, or a
second of real time: a recorder that is killed loses no more. What is missing is counted, by the
stamps and by the middleware, said, and written into the file. A file that can not be written any
further, or is removed, ends the recorder, and it alone, with status 1.
"""

from __future__ import annotations

import json
from pathlib import Path
import time
from typing import Any

import numpy as np
from rclpy.qos import DurabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray

from starcal_ros.config import parameter_file
from starcal_ros.config.scenario import Scenario
from starcal_ros.messages.cdr import RecordError
from starcal_ros.messages.topics import DIAGNOSTICS, TOPICS, TRUE_PARAMETERS, Topic
from starcal_ros.nodes.base import parameters, run_loop
from starcal_ros.nodes.base.managed_node import ManagedNode
from starcal_ros.nodes.base.qos import message_type, offered_qos
from starcal_ros.nodes.base.stamps import is_of_ros, stamp_reader
from starcal_ros.nodes.recorder_channel import Channel, RunTime
from starcal_ros.recording.bag_writer import BagWriter
from starcal_ros.recording.losses import RECORDER, Loss
from starcal_ros.recording.reader import CONFIG_ATTACHMENT, TRUTH_ATTACHMENT
from starcal_ros.simulation.truth import VECTOR_SIZE, from_vector

_FLUSH_S = 1.0                  # a killed recorder loses no more than this
_FLUSH_NS = 5 * 10**8           # nor more than this of the stamps
_FLUSH_BYTES = 16 << 20
_HELD_UP_S = 10.0               # without a turn; publishers give up a subscriber after 20 s
_SEARCH_S = 0.05


class Recorder(ManagedNode):
    """Subscribe to the topics and write what comes, in the order of the stamps.

    Attributes
    ----------
    failed : bool
        Whether the recording had to end; the node then ends.
    gathers_s : float
        How long its inputs may gather: nobody waits for a recording, and no queue is full by then.
    """

    gathers_s = 0.01

    def __init__(self, **options: Any) -> None:
        super().__init__('recorder', 'recorder', **options)
        self._channels: dict[str, Channel] = {}
        self.failed = False
        parameters.follow(self, self.scenario, self._change)
        self.start()

    @property
    def finished(self) -> bool:
        """True when the node has been shut down, or has nothing to write to."""
        return self.failed or super().finished

    def configure(self) -> None:
        """Make the file."""
        options = self.scenario.recorder
        self._channels.clear()
        self._run = RunTime()
        self._newest_ns: dict[str, int] = {}        # by source
        self._flushed_ns: dict[str, int] = {}       # up to where, by source
        self._n_bytes = 0
        self._known = {self.resolve_topic_name(topic.name): topic for topic in TOPICS}
        self._wanted = [self.resolve_topic_name(name) for name in options.topics] or [*self._known]
        self._writer = BagWriter(Path(options.output), options.max_bagfile_size,
                                 options.max_bagfile_duration * 10**9)
        self._writer.attach(CONFIG_ATTACHMENT, parameter_file.dump(self.scenario).encode(),
                            'application/yaml')

    def activate(self) -> None:
        """Subscribe to the topics that are published, and to the others when they are."""
        self._looked_at = time.monotonic()
        self._searched = [*self._wanted]
        self._search()
        self.repeat(_FLUSH_S, self._look_after)
        self.repeat(_SEARCH_S, self._search)
        self.get_logger().info(f'recording to {self._writer.path}')

    def deactivate(self) -> None:
        """Write what has arrived."""
        self._flush()
        for subscription in self.inputs:
            self._channels[subscription.topic].lost_by_middleware += subscription.lost

    def cleanup(self) -> None:
        """Finish the file."""
        self._flush(self.get_clock().now().nanoseconds)
        if self.failed:
            self._writer.give_up()
        else:
            try:
                self._attach_truth()
                self._writer.close()
            except RecordError as error:
                self._fail(error)
        for name, loss in self._writer.losses.items():
            if loss:
                self.get_logger().warning(f'{name}: {loss}')
        counts = {name: channel.count for name, channel in self._channels.items()}
        if not self.failed:
            self.get_logger().info(
                f'{sum(counts.values())} messages recorded to {self._writer.path}: '
                + ', '.join(f'{name} {n}' for name, n in counts.items() if n))

    def _change(self, scenario: Scenario) -> None:
        self.scenario = scenario

    def _fail(self, error: RecordError) -> None:
        """Say what ends the recording."""
        self.failed = True
        self.get_logger().error(str(error))

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
        channel = self._channels.setdefault(name, Channel(
            name, topic.type_name, topic.latched, stamp_reader(kind),
            is_of_ros(kind) or name.endswith(DIAGNOSTICS.name), source or name.rsplit('/', 1)[0],
            self._run))
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

    def _take(self, channel: Channel, batch: list[bytes]) -> None:
        source = channel.source
        newest_ns = channel.take(batch, self._newest_ns.get(source))
        self._n_bytes += sum(map(len, batch))
        if newest_ns is not None:
            self._newest_ns[source] = newest_ns
            self._flushed_ns.setdefault(source, newest_ns)
        if self._n_bytes > _FLUSH_BYTES or (
                newest_ns is not None and newest_ns - self._flushed_ns[source] > _FLUSH_NS):
            self._flush()

    def _look_after(self) -> None:
        """Write what is there, and tell what a user should know."""
        passed_s, self._looked_at = time.monotonic() - self._looked_at, time.monotonic()
        if passed_s > _HELD_UP_S:
            before = self._writer.losses.get(RECORDER, Loss())
            loss = Loss(held_up_s=before.held_up_s + passed_s)
            self._writer.losses[RECORDER] = loss
            self.get_logger().warning(f'{RECORDER}: {loss}')
        self._flush()
        if not self.failed and (text := self._writer.low()):
            self.get_logger().warning(text)

    def _flush(self, otherwise_ns: int | None = None) -> None:
        """Write the messages since the last time, sorted by their log times.

        What came before the first stamp of its source waits for one, of any source.
        """
        if self.failed:
            return
        first_ns = min((t for channel in self._channels.values()
                        for t in channel.log_times_ns if t is not None), default=otherwise_ns)
        batches = []
        for channel in self._channels.values():
            if not channel.messages or (None in channel.log_times_ns and first_ns is None):
                continue
            channel.qos = channel.qos or offered_qos(self, channel.name, channel.latched)
            batches.append(channel.pending(first_ns))
        self._n_bytes = 0
        self._flushed_ns.update(self._newest_ns)
        self._count_losses()
        try:
            self._writer.write(batches)
        except RecordError as error:
            self._fail(error)

    def _count_losses(self) -> None:
        """Tell the writer what is missing, and the user where it is the first of a topic."""
        by_middleware = {subscription.topic: subscription.lost for subscription in self.inputs}
        for name, channel in self._channels.items():
            loss = Loss(channel.gaps.missing, channel.gaps.longest_s,
                        channel.lost_by_middleware + by_middleware.get(name, 0))
            if loss and not self._writer.losses.get(name):
                self.get_logger().warning(f'{name}: {loss}; more of it is told in the end')
            self._writer.losses[name] = loss


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_loop.run(Recorder, args)
