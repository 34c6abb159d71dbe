# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of the suite's topics, and what the graph knows of any topic."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy

from starcal_ros.recording import qos as recorded

STREAM = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_ALL,
                    durability=DurabilityPolicy.VOLATILE)
LATCHED = QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_LAST,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL, depth=1)
POLICIES = {QoSPolicyKind.DURABILITY: 'durability: the last messages for who comes late',
            QoSPolicyKind.DEADLINE: 'deadline: a message at least so often',
            QoSPolicyKind.LIVELINESS: 'liveliness: a sign of life at least so often',
            QoSPolicyKind.RELIABILITY: 'reliability: lost messages sent again'}
"""What is missed where the two sides do not match, in words."""


@cache
def message_type(type_name: str) -> type | None:
    """Return the class of a message type, None where its package is not installed."""
    package, _, name = type_name.partition('/msg/')
    try:
        found: type | None = getattr(import_module(f'{package}.msg'), name, None)
    except ImportError:
        return None
    return found


def offered_qos(node: Node, topic: str, latched: bool) -> tuple[recorded.Qos, ...]:
    """Return what each publisher of a topic offers; publishers that offer the same are one.

    History and depth may not travel over the wire; they are then those of the suite.
    """
    offers = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    if not offers:
        return (recorded.LATCHED,) if latched else (recorded.Qos(),)
    return tuple(dict.fromkeys(map(_qos, offers)))


def _qos(offer: QoSProfile) -> recorded.Qos:
    latched = offer.durability == DurabilityPolicy.TRANSIENT_LOCAL
    stated = offer.history in (HistoryPolicy.KEEP_LAST, HistoryPolicy.KEEP_ALL)
    return recorded.Qos(
        history=offer.history.name.lower() if stated else 'keep_last',
        depth=offer.depth if stated else (recorded.LATCHED if latched else recorded.Qos()).depth,
        reliability=offer.reliability.name.lower(), durability=offer.durability.name.lower(),
        deadline_ns=offer.deadline.nanoseconds, lifespan_ns=offer.lifespan.nanoseconds,
        liveliness=offer.liveliness.name.lower(),
        liveliness_lease_duration_ns=offer.liveliness_lease_duration.nanoseconds,
        avoid_ros_namespace_conventions=offer.avoid_ros_namespace_conventions)
