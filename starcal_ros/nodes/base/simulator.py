# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What the simulator nodes have in common: they publish one run, together, then end."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from starcal_ros.config.scenario import SimulationConfig, stamp_ns
from starcal_ros.nodes.base.convoy import Convoy
from starcal_ros.nodes.base.flow_publisher import FlowPublisher, unheard, when_there
from starcal_ros.nodes.base.pacing import Feed, Item, SimulatedClock, passing_time
from starcal_ros.nodes.base.parameters import AnsweringNode
from starcal_ros.nodes.base.run_loop import Input


class Simulator(AnsweringNode):
    """A node that publishes items in the rhythm of their stamps."""

    def begin(self, simulation: SimulationConfig, sensor: FlowPublisher, items: Iterator[Item]
              ) -> None:
        """Start the run as soon as all are there that it must have.

        These are the subscribers of the sensor's topic, and the other simulators.
        """
        start_ns = stamp_ns('simulation.start_utc', simulation.start_utc)
        convoy = Convoy(self, start_ns)
        self._run_clock = SimulatedClock(start_ns, simulation.real_time_factor,
                                         passing_time(self), lambda: convoy.limit_ns)
        self._feed = Feed(self, self._run_clock, items, convoy.tell)
        # /clock comes by the executor: who goes by it leaves all to it.
        self._inputs: list[Input] = ([] if self.get_parameter('use_sim_time').value
                                     else [self._feed, convoy])
        when_there(self, partial(_missing, sensor, simulation, convoy), self._run_clock.begin)

    @property
    def inputs(self) -> list[Input]:
        """What the loop serves once the run has begun."""
        return self._inputs if self._run_clock.begun else []

    @property
    def finished(self) -> bool:
        """True when the run is over and all of it delivered."""
        return self._feed.finished

    @property
    def drained(self) -> bool:
        """True when all that was published is delivered, or can not be."""
        return self._feed.drained

    def close(self) -> None:
        """Deliver what was published."""
        self._feed.close()


def _missing(sensor: FlowPublisher, simulation: SimulationConfig, convoy: Convoy) -> list[str]:
    """Return who must be there before the run begins, and is not, in words."""
    missing = unheard([sensor], simulation.wait_for_subscribers, simulation.wait_for_nodes)
    simulators = convoy.others
    if simulators < simulation.wait_for_simulators:
        missing.append(f'{simulators} of {simulation.wait_for_simulators} other simulators')
    return missing
