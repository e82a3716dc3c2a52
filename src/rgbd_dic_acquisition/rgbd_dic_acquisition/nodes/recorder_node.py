"""Records topics into a bag, byte for byte as the middleware delivers them.

The executor serves the recorded topics only where /clock gives the time of their arrival. Otherwise the node takes
them by itself, some times a second: the middleware has stamped their arrival and numbered them, so that what is missing
is known (rclpy's EventsExecutor fails with callbacks that ask for that), and one turn takes many.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_srvs.srv import SetBool

from ..bag import BagWriter
from ..errors import RgbdDicError, SettingsError
from ..recording import Recording
from .diagnostics import PERIOD_S, Diagnostics
from .large_pages import use_large_pages
from .parameters import declare, declare_path
from .raw_taking import RawTaking
from .recorder_health import RecorderHealth
from .recorder_settings import RecorderSettings
from .ros_messages import message_class
from .spinning import run

DISCOVER_S = 0.2
TAKE_S = 0.1
NEVER_DISCOVERED = ("/clock", "/rosout", "/parameter_events")
MB = 1_000_000


class RecorderNode(Node):
    """Writes the bag `output`; SIGINT and SIGTERM finish it."""

    def __init__(self) -> None:
        self._recorded: dict[str, Subscription | None] = {}
        self._by_clock = True
        super().__init__("recorder_node")
        self._by_clock = self.get_clock().ros_time_is_active
        self._settings = settings = declare(self, RecorderSettings)
        output = declare_path(self, "output", "the directory of the bag to be made")
        wanted = [_parse(entry) for entry in settings.topics if entry]
        bag = BagWriter(output, settings.compression, settings.split_mb * MB, durable=True)
        self._recording = Recording(bag, settings.buffer_mb * MB, settings.reserve_mb * MB)
        self._diagnostics = Diagnostics(self)
        self._health = RecorderHealth(self._diagnostics, self._recording, settings.warning_s)
        self._latched: dict[str, bool] = {}
        self._taking = RawTaking()
        self._writes = True
        self.create_service(SetBool, "~/record", self._set_writing)
        self._diagnostics.tell("recording", "on")
        for name, typename, latched, reliable in wanted:
            self._subscribe(self.resolve_topic_name(name), typename, latched, reliable)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if not wanted:
            self.create_timer(DISCOVER_S, self._discover, clock=steady)
        self.create_timer(PERIOD_S, self._health.report, clock=steady)
        self.get_logger().info(f"recording into {output}")

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Those that the executor serves."""
        return (known for known in super().subscriptions if self._by_clock or known.topic not in self._recorded)

    def work(self) -> Iterator[float]:
        while True:
            if not self._by_clock:
                self._take()
            yield TAKE_S

    def close(self) -> None:
        """Take what arrives until nobody publishes any more or `linger_s` is over, and finish the bag."""
        end = time.monotonic() + self._settings.linger_s
        while time.monotonic() < end and any(map(self._is_published, self._recorded)):
            self._take()
            time.sleep(TAKE_S)
        self._take()
        try:
            self._recording.close()
        finally:
            counts, dropped = self._recording.bag.counts, sum(self._recording.dropped.values())
            lost = f"; {dropped} were dropped" if dropped else ""
            self.get_logger().info(f"recorded {sum(counts.values())} messages of {len(counts)} topics{lost}")

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
            self._recording.add_topic(topic, typename, latched, reliable)
        except RgbdDicError as error:
            self._health.not_recorded(f"{topic} is not recorded: {error}")
            return
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=self._settings.queue_depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        self._recorded[topic] = self.create_subscription(
            kind, topic, lambda data: self._record([(topic, self.get_clock().now().nanoseconds, data)]), qos, raw=True
        )

    def _is_published(self, topic: str) -> bool:
        """Whether anybody else does."""
        own = (self.get_name(), self.get_namespace())
        return any((info.node_name, info.node_namespace) != own for info in self.get_publishers_info_by_topic(topic))

    def _set_writing(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Latched topics are recorded in any case: what comes later rests on them."""
        self._writes = request.data
        self._diagnostics.tell("recording", "on" if request.data else "off")
        response.success = not self._recording.ended
        response.message = "recording" if request.data else "not recording until it is started again"
        response.message = self._recording.ended or response.message
        self.get_logger().info(response.message)
        return response

    def _take(self) -> None:
        """Record what has arrived, in the order in which it did."""
        taken = []
        for topic, subscription in self._recorded.items():
            while subscription and (message := self._taking.take(subscription)) is not None:
                self._health.arrived(topic, message.number, self.count_publishers)
                taken.append((topic, message.received_ns, message.data))
        taken.sort(key=lambda message: message[1])
        now_ns = self.get_clock().now().nanoseconds
        self._record(
            [(topic, now_ns if self._by_clock else received_ns or now_ns, data) for topic, received_ns, data in taken]
        )

    def _record(self, messages: Sequence[tuple[str, int, bytes]]) -> None:
        wanted = messages if self._writes else [message for message in messages if self._latched[message[0]]]
        if len(wanted) < len(messages):
            self._diagnostics.count("not recorded, as told", len(messages) - len(wanted))
        self._recording.put(wanted)


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
    if args is None:  # as a program
        use_large_pages()
    return run(RecorderNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
