# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""What a publisher offers, as a recording states it."""

from __future__ import annotations

from dataclasses import dataclass

ENDLESS_NS = 2**63 - 1
"""A duration without end, as ROS 2 writes it."""


@dataclass(frozen=True)
class Qos:
    """What a publisher offers: the nine policies of ROS 2."""

    history: str = 'keep_last'
    depth: int = 100
    reliability: str = 'reliable'
    durability: str = 'volatile'
    deadline_ns: int = ENDLESS_NS
    lifespan_ns: int = ENDLESS_NS
    liveliness: str = 'automatic'
    liveliness_lease_duration_ns: int = ENDLESS_NS
    avoid_ros_namespace_conventions: bool = False

    @property
    def profile(self) -> str:
        """All policies as rosbag2 records them, YAML."""
        def duration(ns: int) -> str:
            return '{sec: %d, nsec: %d}' % divmod(ns, 10**9)
        return (f'- history: {self.history}\n  depth: {self.depth}\n'
                f'  reliability: {self.reliability}\n  durability: {self.durability}\n'
                f'  deadline: {duration(self.deadline_ns)}\n'
                f'  lifespan: {duration(self.lifespan_ns)}\n  liveliness: {self.liveliness}\n'
                '  liveliness_lease_duration: '
                f'{duration(self.liveliness_lease_duration_ns)}\n'
                '  avoid_ros_namespace_conventions: '
                f'{str(self.avoid_ros_namespace_conventions).lower()}')


LATCHED = Qos(depth=1, durability='transient_local')
