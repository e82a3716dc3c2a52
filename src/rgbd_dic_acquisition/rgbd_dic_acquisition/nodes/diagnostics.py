"""What a node says about itself on /diagnostics, once a second."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node

MATCHED = "matched subscriptions"
STAMPS = "uncertainty of the stamps [ms]"
PERIOD_S = 1.0
SOONEST_S = 0.1  # after another, for a change; it goes out with the next `warn` or `ok` after that
REPEAT_WARNING_S = 5.0


class WatchedPublisher:
    """A publisher that knows how much it has published."""

    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher
        self.topic: str = publisher.topic_name
        self.sent = 0
        self._last_sent = float("nan")
        self._reported = (time.monotonic(), 0)
        self._receivers: list[Callable[[Any], None]] = []

    def publish(self, message: Any) -> None:
        """Publish a message, or its serialised bytes."""
        self._publisher.publish(message)
        for receive in self._receivers:
            receive(message)
        self.sent += 1
        self._last_sent = time.monotonic()

    @property
    def matched(self) -> int:
        """How many subscriptions the publisher is connected to, those in this process that are called among them."""
        return self._publisher.get_subscription_count() + len(self._receivers)

    def confirmed(self) -> bool:
        """Whether all reliable subscriptions have what was published and is still kept for them."""
        return self._publisher.wait_for_all_acked(Duration(seconds=0))

    def hand_to(self, receive: Callable[[Any], None]) -> None:
        """Call this, too, with each message that is published from now on."""
        self._receivers.append(receive)

    def destroy(self, node: Node) -> None:
        """Take the publisher down; `sent` and `topic` remain."""
        node.destroy_publisher(self._publisher)

    def report(self) -> list[KeyValue]:
        now = time.monotonic()
        since, sent_before = self._reported
        self._reported = (now, self.sent)
        rate = (self.sent - sent_before) / max(now - since, 1e-6)
        return [
            _pair("messages sent", self.sent),
            _pair("rate [1/s]", f"{rate:.2f}"),
            _pair("age of the last [s]", f"{now - self._last_sent:.3f}"),
            _pair(MATCHED, self.matched),
        ]


class Diagnostics:
    """One status for the node (its counters, what it tells, its level and message) and one for each watched publisher.

    Status names are `/node` and `/node: /topic`. The level is OK, or what `warn` or `error` last set it to, until `ok`;
    a change is sent at once. It runs by the steady clock, so that a node that waits for /clock is heard too.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._name = node.get_fully_qualified_name()
        self._counters: Counter[str] = Counter()
        self._told: dict[str, str] = {}
        self._latest_ns, self._largest_ns = math.inf, -math.inf  # uncertainty of stamps; the largest since a status
        self._publishers: list[WatchedPublisher] = []
        self._level, self._problem, self._untold = DiagnosticStatus.OK, "", False
        self._logged_at = self._sent_at = float("-inf")
        self._output = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._timer = node.create_timer(PERIOD_S, self._publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def watch(self, publisher: Any) -> WatchedPublisher:
        """Report on a publisher from now on; publish through what this returns."""
        watched = WatchedPublisher(publisher)
        self._publishers.append(watched)
        return watched

    @property
    def outputs(self) -> tuple[WatchedPublisher, ...]:
        """The publishers that are reported on."""
        return tuple(self._publishers)

    def forget(self, watched: WatchedPublisher) -> None:
        """Report no more on a publisher that is about to be destroyed."""
        self._publishers.remove(watched)

    def count(self, name: str, n: int = 1) -> None:
        """Add to a counter, such as "received", "dropped" or "invalid"."""
        self._counters[name] += n

    def tell(self, name: str, value: str, at_once: bool = False) -> None:
        """Put a value beside the counters; it stays until it is told anew.

        Args:
            at_once: a change is sent with the level that is set next, not only within a second.
        """
        self._untold = self._untold or (at_once and self._told.get(name) != value)
        self._told[name] = value

    def tell_stamp(self, uncertainty_ns: float) -> None:
        """Put the standard uncertainty of stamps beside the counters: each status has the largest since the one before.

        To be called with each stamp. That it is known now, and was not before, is sent with the level that is set next.
        """
        self._untold = self._untold or (math.isfinite(uncertainty_ns) and not math.isfinite(self._latest_ns))
        self._largest_ns, self._latest_ns = max(uncertainty_ns, self._largest_ns), uncertainty_ns

    def warn(self, text: str) -> None:
        """Set the level to WARN, and log the text (at most every few seconds while it stays the same)."""
        if self._is_to_be_logged(text):
            self._node.get_logger().warning(text)
        self._set(DiagnosticStatus.WARN, text)

    def error(self, text: str) -> None:
        """Set the level to ERROR, for a node that goes on but cannot do its work any more; log it like a warning."""
        if self._is_to_be_logged(text):
            self._node.get_logger().error(text)
        self._set(DiagnosticStatus.ERROR, text)

    def ok(self) -> None:
        """Set the level back to OK."""
        self._set(DiagnosticStatus.OK, "")

    def _is_to_be_logged(self, text: str) -> bool:
        now = time.monotonic()
        if text == self._problem and now - self._logged_at <= REPEAT_WARNING_S:
            return False
        self._logged_at = now
        return True

    def _set(self, level: bytes, problem: str) -> None:
        self._untold = self._untold or (level, problem) != (self._level, self._problem)
        self._level, self._problem = level, problem
        if self._untold and time.monotonic() - self._sent_at > SOONEST_S:
            self._publish()

    def _publish(self) -> None:
        self._sent_at, self._untold = time.monotonic(), False
        if self._largest_ns >= 0:
            self._told[STAMPS] = f"{self._largest_ns * 1e-6:.3f}"
            self._largest_ns = -math.inf
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=self._level,
                name=self._name,
                message=self._problem or "OK",
                values=[_pair(*named) for named in (*sorted(self._counters.items()), *self._told.items())],
            )
        ]
        message.status += [
            DiagnosticStatus(
                level=DiagnosticStatus.OK,
                name=f"{self._name}: {watched.topic}",
                message="OK" if watched.sent else "nothing sent yet",
                values=watched.report(),
            )
            for watched in self._publishers
        ]
        self._output.publish(message)


def matched_subscriptions(message: DiagnosticArray) -> dict[tuple[str, str], int]:
    """From what a node reports: (node, topic) -> how many subscriptions its publisher is connected to."""
    matched = {}
    for status in message.status:
        node, separator, topic = status.name.partition(": ")
        for pair in status.values:
            if separator and pair.key == MATCHED:
                matched[node, topic] = int(pair.value)
    return matched


def _pair(key: str, value: object) -> KeyValue:
    return KeyValue(key=key, value=str(value))
