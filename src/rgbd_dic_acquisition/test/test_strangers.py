"""A viewer's subscription is not taken for that of a node that is waited for."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator

import pytest
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rgbd_dic_acquisition.nodes.strangers import strangers
from std_msgs.msg import Empty

RELIABLE, BEST_EFFORT = (
    QoSProfile(depth=1, reliability=kind) for kind in (ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT)
)


@pytest.fixture
def make_node() -> Iterator[Callable[[str], Node]]:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=10 + os.getpid() % 90)
    nodes: list[Node] = []

    def make(name: str) -> Node:
        nodes.append(Node(name, namespace="uav1", context=context))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown(context=context)


def settled(node: Node, topic: str, subscriptions: int) -> None:
    end = time.monotonic() + 30
    while len(node.get_subscriptions_info_by_topic(topic)) < subscriptions:
        assert time.monotonic() < end
        time.sleep(0.05)


def test_subscriptions_of_others_that_the_publisher_can_serve(make_node: Callable[[str], Node]) -> None:
    player, plane, viewer, deaf = map(make_node, ("player_node", "plane_node", "viewer_node", "deaf_node"))
    player.create_publisher(Empty, "depth", BEST_EFFORT)
    plane.create_subscription(Empty, "depth", lambda _: None, BEST_EFFORT)
    viewer.create_subscription(Empty, "depth", lambda _: None, BEST_EFFORT)
    deaf.create_subscription(Empty, "depth", lambda _: None, RELIABLE)
    settled(player, "depth", 3)
    assert strangers(player, "player_node", "depth", ["plane_node"]) == 1
    assert strangers(player, "player_node", "/uav1/depth", ["plane_node", "viewer_node"]) == 0
    assert strangers(player, "player_node", "depth", ["recorder_node"]) == 2
    assert strangers(player, "nobody", "depth", ["plane_node"]) == 0
