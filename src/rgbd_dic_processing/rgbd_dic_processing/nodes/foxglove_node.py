"""foxglove_node: a websocket on this computer for Foxglove; it hears a topic only while a viewer shows it."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_acquisition.message_types import definition
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, message_class
from rgbd_dic_acquisition.nodes.spinning import run
from rgbd_dic_acquisition.settings import Settings, setting

NICENESS = 10  # the measurement goes first
HOST = "127.0.0.1"  # the protocol knows no token: nobody else may ask
OFFER_S, FOLLOW_S = 1.0, 0.1
COMMON_TOPICS = ("/diagnostics", "/rosout", "/tf", "/tf_static")
LARGE_BYTES = 64 * 1024
DEPTH = 10


@dataclass(frozen=True)
class FoxgloveSettings(Settings):
    """The websocket for Foxglove."""

    port: int = setting(8765, low=0, high=65535, doc="port to listen on; 0 takes a free one")
    large_rate_hz: float = setting(
        5.0,
        unit="1/s",
        low=0.1,
        high=1000.0,
        doc="most messages above 64 KB that go out on a topic; the rest is left out",
    )
    backlog: int = setting(
        64, unit="messages", low=8, high=10000, doc="kept for each viewer; the oldest are dropped for a slow one"
    )


@dataclass
class Served:
    """A topic that is offered. due_s: when the next large message may go; last: of a latched topic."""

    channel: Any
    kind: type
    latched: bool
    subscription: Subscription | None = None
    last: bytes | None = None
    due_s: float = 0.0


class FoxgloveNode(Node):
    def __init__(self) -> None:
        super().__init__("foxglove_node")
        self._settings = declare(self, FoxgloveSettings, "foxglove")
        self._diagnostics = Diagnostics(self)
        self._topics: dict[str, Served | None] = {}
        self._asked: SimpleQueue[str] = SimpleQueue()
        self._simulated = self.get_parameter("use_sim_time").value
        self._sdk = self._server = None

    def work(self) -> Iterator[float]:
        """Serve; the rest is done by timers."""
        self._sdk, self._server = self._serve()
        self.get_logger().info(f"serving Foxglove on ws://{HOST}:{self._server.port}")
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(OFFER_S, self._offer, clock=steady)
        self.create_timer(FOLLOW_S, self._follow, clock=steady)
        while True:
            yield OFFER_S

    def close(self) -> None:
        if self._server is not None:
            self._server.stop()

    def _serve(self) -> tuple[Any, Any]:
        try:
            import foxglove
            from foxglove.websocket import Capability, ServerListener
        except ImportError as error:
            raise RgbdDicError(f"{error}: install foxglove-sdk, by make setup-viewers") from error
        asked = self._asked

        class Listener(ServerListener):
            def on_subscribe(self, client: Any, channel: Any) -> None:
                asked.put(channel.topic)

        self._offered_to = foxglove.Context()
        try:
            return foxglove, foxglove.start_server(
                name="rgbd_dic",
                host=HOST,
                port=self._settings.port,
                capabilities=[Capability.Time] if self._simulated else [],
                server_listener=Listener(),
                context=self._offered_to,
                message_backlog_size=self._settings.backlog,
            )
        except Exception as error:  # its errors have no common base
            raise RgbdDicError(
                f"cannot serve Foxglove on {HOST} port {self._settings.port}: {error}; choose another foxglove.port"
            ) from error

    def _offer(self) -> None:
        """Topics that have appeared."""
        namespace = self.get_namespace().rstrip("/") + "/"
        for topic, types in self.get_topic_names_and_types():
            hidden = any(part.startswith("_") for part in topic.split("/"))
            inside = topic.startswith(namespace) and topic not in ("/clock", "/parameter_events")
            if topic not in self._topics and not hidden and (inside or topic in COMMON_TOPICS):
                offered = [info.qos_profile.durability for info in self.get_publishers_info_by_topic(topic)]
                if offered:
                    latched = all(durability == DurabilityPolicy.TRANSIENT_LOCAL for durability in offered)
                    self._topics[topic] = self._served(topic, types[0], latched)

    def _served(self, topic: str, typename: str, latched: bool) -> Served | None:
        try:
            kind, (text, _) = message_class(typename), definition(typename)
        except RgbdDicError as error:
            self._diagnostics.warn(f"{topic} is not served: {error}")
            return None
        schema = self._sdk.Schema(name=typename, encoding="ros2msg", data=text.encode())
        channel = self._sdk.Channel(topic, message_encoding="cdr", schema=schema, context=self._offered_to)
        return Served(channel, kind, latched)

    def _follow(self) -> None:
        """Hear what is shown."""
        if self._simulated and (now_ns := self.get_clock().now().nanoseconds):
            self._server.broadcast_time(now_ns)
        for topic, served in self._topics.items():
            if served is None:
                continue
            shown = served.channel.has_sinks()
            if shown and served.subscription is None:
                served.subscription = self._subscribe(topic, served)
            elif not shown and served.subscription is not None:
                self.destroy_subscription(served.subscription)
                served.subscription = None
        while not self._asked.empty():
            served = self._topics.get(self._asked.get())
            if served is not None and served.last is not None:  # whoever comes later
                self._send(served, served.last)

    def _subscribe(self, topic: str, served: Served) -> Subscription:
        best_effort = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        qos = latched_qos() if served.latched else best_effort
        return self.create_subscription(served.kind, topic, lambda data: self._heard(served, data), qos, raw=True)

    def _heard(self, served: Served, data: bytes) -> None:
        if served.latched:
            served.last = data
        elif len(data) > LARGE_BYTES:
            now_s = time.monotonic()
            if now_s < served.due_s:
                return
            served.due_s = now_s + 1 / self._settings.large_rate_hz
        self._send(served, data)

    def _send(self, served: Served, data: bytes) -> None:
        served.channel.log(data, log_time=self.get_clock().now().nanoseconds)


def main(args: Sequence[str] | None = None) -> int:
    os.nice(NICENESS)
    return run(FoxgloveNode, args)
