"""The graph's answers to the images that are played to it."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from ..errors import RgbdDicError, SettingsError
from ..in_flight import InFlight, header_stamp_ns
from .ros_messages import message_class

STEP_S = 0.05


class Answers:
    """Listens on the acknowledging topics and holds back who runs too far ahead of them.

    Args:
        topics: 'NAME TYPE' of each; every one brings one message, with the image's stamp, for each image.

    Attributes:
        in_flight: the images that are not answered yet.

    Raises:
        SettingsError: a topic is not of that form.
    """

    def __init__(self, node: Node, topics: Sequence[str], timeout_s: float, queue_depth: int) -> None:
        self._node, self._timeout_s, self._qos = node, timeout_s, QoSProfile(depth=queue_depth)
        split = [entry.split() for entry in topics]
        for entry, words in zip(topics, split, strict=True):
            if len(words) != 2:
                raise SettingsError(f"acknowledge_topics: '{entry}' is not understood; give 'NAME TYPE'")
        self.in_flight = InFlight(name for name, _ in split)
        self._progressed_at = time.monotonic()
        self._subscriptions = [self._subscribe(name, typename) for name, typename in split]

    def without_publisher(self) -> list[str]:
        """Topics that nobody is connected to publish."""
        return [item.topic_name for item in self._subscriptions if not item.get_publisher_count()]

    def wait(self, unanswered: int) -> Iterator[float]:
        """Wait until at most so many images are unanswered.

        Raises:
            RgbdDicError: none of them was answered in time; names the topics and the stamp.
        """
        self._progressed_at = time.monotonic()
        while len(self.in_flight) > unanswered:
            if time.monotonic() - self._progressed_at > self._timeout_s:
                raise RgbdDicError(
                    f"no answer within {self._timeout_s:g} s: waiting for {self.in_flight.oldest()}. "
                    "Is its node running, and does it answer every image?"
                )
            yield STEP_S

    def _subscribe(self, name: str, typename: str) -> Subscription:
        def take(data: bytes) -> None:
            if self.in_flight.acknowledged(name, header_stamp_ns(data)):
                self._progressed_at = time.monotonic()

        return self._node.create_subscription(message_class(typename), name, take, self._qos, raw=True)
