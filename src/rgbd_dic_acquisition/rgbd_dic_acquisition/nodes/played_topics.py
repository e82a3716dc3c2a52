"""The publishers of a bag's topics, and of /clock."""

from __future__ import annotations

from collections.abc import Collection

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from ..bag import BagReader
from ..errors import RgbdDicError, SettingsError
from ..messages import stamp_message
from ..offered_qos import latched_topics
from .diagnostics import Diagnostics, WatchedPublisher
from .ros_messages import latched_qos, make, message_class

CLOCK = "clock"
TRANSFORMS = ("tf", "tf_static")


class PlayedTopics:
    """One publisher for each topic of a bag that is played.

    The names are relative, so that a namespace works; only the transforms and /clock stay absolute. Latched
    topics are latched again. A /clock in the bag is not played: it comes from the log times.

    Args:
        chosen: names of topics, with or without the first slash; empty plays all.

    Raises:
        BagError: the bag has no such topic.
    """

    def __init__(
        self, node: Node, diagnostics: Diagnostics, bag: BagReader, chosen: Collection[str], queue_depth: int
    ) -> None:
        names = {name.lstrip("/"): name for name in bag.topics}
        self._by_name: dict[str, WatchedPublisher] = {}
        self._by_bag_topic: dict[str, WatchedPublisher] = {}
        latched = latched_topics(bag.path)
        for name in [name.lstrip("/") for name in chosen] or names:
            info = bag.topics[bag.require(name, bag.topics[names[name]].type if name in names else "")]
            if name == CLOCK:
                continue
            try:
                kind = message_class(info.type)
            except RgbdDicError as error:
                diagnostics.warn(f"{names[name]} is not played: {error}")
                continue
            deep = QoSProfile(depth=queue_depth)
            qos = latched_qos(min(max(info.count, 1), queue_depth)) if names[name] in latched else deep
            topic = f"/{name}" if name in TRANSFORMS else name
            self._by_name[name] = diagnostics.watch(node.create_publisher(kind, topic, qos))
            self._by_bag_topic[names[name]] = self._by_name[name]
        clock = node.create_publisher(Clock, f"/{CLOCK}", queue_depth)
        self._by_name[CLOCK] = diagnostics.watch(clock)
        self._clock_ns = bag.start_ns
        self._node, self._diagnostics, self._clock_runs = node, diagnostics, True

    @property
    def in_bag(self) -> list[str]:
        """The topics that are played, as the bag names them."""
        return list(self._by_bag_topic)

    @property
    def publishers(self) -> list[WatchedPublisher]:
        return list(self._by_name.values())

    def publisher(self, name: str) -> WatchedPublisher:
        """By its name, with or without the first slash.

        Raises:
            SettingsError: that topic is not played.
        """
        if name.lstrip("/") not in self._by_name:
            raise SettingsError(f"{name} is not played; played are {', '.join(self._by_name)}")
        return self._by_name[name.lstrip("/")]

    def publish(self, bag_topic: str, log_time_ns: int, data: bytes) -> None:
        """Publish a message of the bag, and before it the time at which it was recorded."""
        self._clock_ns = max(self._clock_ns, log_time_ns)
        self.publish_clock()
        self._by_bag_topic[bag_topic].publish(data)

    def publish_clock(self) -> None:
        """Publish the time that the playing has reached; nothing after `end_clock`."""
        if self._clock_runs:
            self._by_name[CLOCK].publish(Clock(clock=stamp_message(make, self._clock_ns)))

    def end_clock(self) -> None:
        """Take /clock down: who follows it knows by that that no message will come any more."""
        self._clock_runs = False
        self._diagnostics.forget(self._by_name[CLOCK])
        self._by_name[CLOCK].destroy(self._node)
