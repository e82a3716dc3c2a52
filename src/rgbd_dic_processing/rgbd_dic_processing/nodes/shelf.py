"""Messages that are fetched now and then instead of being delivered one by one, which costs a fraction."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription


class Shelf:
    """A topic on a node that no executor spins. Best effort: whoever publishes never waits for it."""

    def __init__(self, node: Node, kind: type, topic: str, depth: int):
        self._kind, self._topic = kind, node.resolve_topic_name(topic)
        self._qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._node = Node(
            f"{node.get_name()}_shelf",
            namespace=node.get_namespace(),
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._subscription: Subscription | None = None

    def listen(self) -> None:
        if self._subscription is None:
            self._subscription = self._node.create_subscription(self._kind, self._topic, lambda _: None, self._qos)

    def rest(self) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def taken(self) -> Iterator[Any]:
        """The messages that have come since the last call."""
        while self._subscription is not None:
            with self._subscription.handle:
                taken = self._subscription.handle.take_message(self._kind, False)
            if taken is None:
                return
            yield taken[0]

    def close(self) -> None:
        self.rest()
        self._node.destroy_node()
