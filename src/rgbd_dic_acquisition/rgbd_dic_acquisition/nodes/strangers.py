"""Subscriptions of nodes that nobody waits for, such as viewers, which come and go as they like."""

from __future__ import annotations

from collections.abc import Collection

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible


def strangers(node: Node, publisher: str, topic: str, known: Collection[str]) -> int:
    """How many subscriptions of a topic belong to nodes not known, as far as its publisher can serve them.

    A publisher knows how many subscriptions it is connected to, not whose they are: as long as these are not taken
    off, one of them may stand for a node that is waited for.

    Args:
        node: sees the graph.
        publisher, known: names of nodes, without their namespaces.
        topic: with or without the node's namespace.
    """
    offers = [info.qos_profile for info in node.get_publishers_info_by_topic(topic) if info.node_name == publisher]
    others = [info for info in node.get_subscriptions_info_by_topic(topic) if info.node_name not in known]
    return sum(
        any(qos_check_compatible(offer, other.qos_profile)[0] != QoSCompatibility.ERROR for offer in offers)
        for other in others
    )
