# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the simulator nodes have in common: they publish one run, then end."""

from __future__ import annotations

from collections.abc import Iterator

from starcal_ros.config.scenario import SimulationConfig, stamp_ns
from starcal_ros.nodes.base.flow_publisher import FlowPublisher, when_subscribed
from starcal_ros.nodes.base.pacing import Feed, Item, SimulatedClock, passing_time
from starcal_ros.nodes.base.parameters import AnsweringNode


class Simulator(AnsweringNode):
    """A node that publishes items in the rhythm of their stamps."""

    def begin(self, simulation: SimulationConfig, sensor: FlowPublisher, items: Iterator[Item]
              ) -> None:
        """Start the run as soon as the sensor's topic has the subscribers it must have."""
        start_ns = stamp_ns('simulation.start_utc', simulation.start_utc)
        clock = SimulatedClock(start_ns, simulation.real_time_factor, passing_time(self))
        self._feed = Feed(self, clock, items)
        when_subscribed(self, [sensor], simulation.wait_for_subscribers, clock.begin)

    @property
    def finished(self) -> bool:
        """True when the run is over and all of it delivered."""
        return self._feed.finished

    def close(self) -> None:
        """Deliver what was published."""
        self._feed.close()
