"""Records topics into a bag, byte for byte as the middleware delivers them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_srvs.srv import SetBool

from ..bag import BagWriter
from ..errors import RgbdDicError, SettingsError
from ..settings import Settings, setting
from .diagnostics import Diagnostics
from .parameters import declare, declare_path
from .ros_messages import message_class
from .spinning import run

POLL_S = 0.2
NEVER_DISCOVERED = ("/clock", "/rosout", "/parameter_events")
# Messages held until /clock says what time it is.
HELD = 1000


@dataclass(frozen=True)
class RecorderSettings(Settings):
    """What is recorded, and how."""

    topics: tuple[str, ...] = setting(
        (),
        doc="'NAME TYPE', with 'latched' or 'best_effort' after it where that is how the topic is offered; "
        "empty records every topic of the node's namespace and /tf_static as they appear",
    )
    queue_depth: int = setting(
        200, doc="messages of a topic kept while the disk is slow", unit="messages", low=1, high=10000
    )
    compression: str = setting(
        "none", doc="of the bag; zstd costs half a core and saves little", choices=("none", "zstd")
    )


class RecorderNode(Node):
    """Writes the bag `output`; SIGINT and SIGTERM finish it."""

    def __init__(self) -> None:
        super().__init__("recorder_node")
        self._settings = declare(self, RecorderSettings)
        output = declare_path(self, "output", "the directory of the bag to be made")
        wanted = [_parse(entry) for entry in self._settings.topics if entry]
        self._diagnostics = Diagnostics(self)
        self._recorded: dict[str, Subscription | None] = {}
        self._latched: dict[str, bool] = {}
        self._held: deque[tuple[str, bytes]] = deque(maxlen=HELD)
        self._bag = BagWriter(output, self._settings.compression)
        self._writes = True
        self.create_service(SetBool, "~/record", self._set_writing)
        self._diagnostics.tell("recording", "on")
        for name, typename, latched, reliable in wanted:
            self._subscribe(self.resolve_topic_name(name), typename, latched, reliable)
        if not wanted:
            self.create_timer(POLL_S, self._discover, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"recording into {output}")

    def close(self) -> None:
        """Take what has arrived and not been handled yet, and finish the bag."""
        for topic, subscription in self._recorded.items():
            while subscription and (taken := _take(subscription)) is not None:
                self._record(topic, taken)
        self._write_held()
        self._bag.close()
        total = sum(self._bag.counts.values())
        self.get_logger().info(f"recorded {total} messages of {len(self._bag.counts)} topics")

    def _discover(self) -> None:
        namespace = self.get_namespace().rstrip("/") + "/"
        for topic, types in self.get_topic_names_and_types():
            hidden = any(part.startswith("_") for part in topic.split("/"))
            inside = topic.startswith(namespace) or topic == "/tf_static"
            if topic in self._recorded or topic in NEVER_DISCOVERED or hidden or not inside:
                continue
            offered = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
            if offered:
                latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
                reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
                self._subscribe(topic, types[0], latched, reliable)

    def _subscribe(self, topic: str, typename: str, latched: bool, reliable: bool) -> None:
        self._recorded[topic], self._latched[topic] = None, latched
        try:
            kind = message_class(typename)
            self._bag.add_topic(topic, typename, transient_local=latched, reliable=reliable)
        except RgbdDicError as error:
            self._diagnostics.warn(f"{topic} is not recorded: {error}")
            return
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=self._settings.queue_depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        self._recorded[topic] = self.create_subscription(
            kind, topic, lambda data: self._record(topic, data), qos, raw=True
        )

    def _set_writing(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Latched topics are recorded in any case: what comes later rests on them."""
        self._writes = request.data
        self._diagnostics.tell("recording", "on" if request.data else "off")
        response.success = True
        response.message = "recording" if request.data else "not recording until it is started again"
        self.get_logger().info(response.message)
        return response

    def _record(self, topic: str, data: bytes) -> None:
        if not (self._writes or self._latched[topic]):
            self._diagnostics.count("not recorded, as told")
            return
        self._diagnostics.count(f"recorded {topic}")
        self._held.append((topic, data))
        if self.get_clock().now().nanoseconds > 0:
            self._write_held()

    def _write_held(self) -> None:
        while self._held:
            topic, data = self._held.popleft()
            self._bag.write(topic, self.get_clock().now().nanoseconds, data)


def _take(subscription: Subscription) -> bytes | None:
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, True)
    return None if taken is None else taken[0]


def _parse(entry: str) -> tuple[str, str, bool, bool]:
    """'NAME TYPE [latched] [best_effort]' -> (name, type, latched, reliable)"""
    name, typename, *words = [*entry.split(), "", ""][: max(2, len(entry.split()))]
    if not typename or set(words) - {"latched", "best_effort"}:
        raise SettingsError(
            f"topics: '{entry}' is not understood; give 'NAME TYPE' and, where it applies, 'latched' or "
            "'best_effort', such as 'camera/image_raw sensor_msgs/msg/Image'"
        )
    return name, typename, "latched" in words, "best_effort" not in words


def main(args: Sequence[str] | None = None) -> int:
    return run(RecorderNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
