# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0
"""Who is about to end: so that nodes that are all asked at once end in the order of the data.

A launch, or Ctrl-C in a terminal, asks all nodes in the same moment. Each then offers a hidden
topic, on which nothing is published: its publishers in the graph are the nodes that are ending.
A node that listens goes on until those of them that speak to it have left, which they do when all
that they said has been acknowledged. So simulators end first, then the estimator, then the
recorder, and nothing is lost between them. A sensor that is not asked to end is not waited for.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from weakref import WeakKeyDictionary

from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Empty

TOPIC = '/_starcal/ending'
SETTLE_S = 1.0          # after a stop, until all that are asked to end have said so
_SAID: WeakKeyDictionary[Node, Publisher[Any]] = WeakKeyDictionary()


def announce(node: Node) -> None:
    """Say that a node is about to end; once or more often is the same."""
    if node not in _SAID:
        _SAID[node] = node.create_publisher(Empty, TOPIC, 1)


def speakers(node: Node, topics: Iterable[str]) -> list[str]:
    """Return which other nodes are about to end and still publish one of the topics."""
    own = node.get_namespace(), node.get_name()
    ending = _publishers(node, TOPIC) - {own}
    found = {each for topic in topics for each in _publishers(node, topic)} if ending else set()
    return sorted(f'{namespace.rstrip("/")}/{name}' for namespace, name in ending & found)


def _publishers(node: Node, topic: str) -> set[tuple[str, str]]:
    return {(info.node_namespace, info.node_name)
            for info in node.get_publishers_info_by_topic(topic)}
