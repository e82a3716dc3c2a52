"""Subscriptions that are there only while somebody needs what they bring."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

Stream = tuple[type, str, Callable[[Any], None], QoSProfile] | tuple[type, str, Callable[[Any], None], QoSProfile, bool]


class WhileWanted:
    """Args: streams: type, topic, callback, quality of service and, if it takes bytes as they come, True."""

    def __init__(self, node: Node, *streams: Stream):
        self._node, self._streams = node, streams
        self._heard: list[Subscription] = []

    def follow(self, wanted: bool) -> None:
        """Subscribe, or end the subscriptions; nothing if it is so already."""
        if wanted and not self._heard:
            self._heard = [
                self._node.create_subscription(*stream[:4], raw=bool(stream[4:])) for stream in self._streams
            ]
        elif not wanted:
            for subscription in self._heard:
                self._node.destroy_subscription(subscription)
            self._heard = []
