"""What a node does with messages that come faster than it works: it leaves some out, evenly, and says so."""

from __future__ import annotations

import contextlib
import itertools
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare
from rgbd_dic_acquisition.nodes.spinning import TURN_S
from rgbd_dic_acquisition.settings import Settings, setting

SKIPPED = "skipped"  # counter on /diagnostics
WARNED_S = 2.0  # after a message was left out
EVENTS = 20  # of the executor that a node which lags behind handles between two messages, so that nothing else waits


@dataclass(frozen=True)
class KeepUpSettings(Settings):
    """What becomes of messages that come faster than a node works."""

    max_waiting: int = setting(
        0,
        unit="messages",
        low=0,
        high=1000,
        doc="when more wait, the oldest are left out, so that latency does not grow; 0: none is left out",
    )


class KeepUp:
    """Subscribes so that a slow node stays up to date: when a message's turn has come, all that came meanwhile is
    looked at, and while more than `max_waiting` wait behind it, it is left out and counted, and the next one's turn
    has come. A node that takes twice as long as messages need to come so works off every second one.

    The node's `work` must be this one's.
    """

    def __init__(self, node: Node, diagnostics: Diagnostics):
        self._node, self._diagnostics = node, diagnostics
        self._most = declare(node, KeepUpSettings, "keep_up").max_waiting
        self._waiting: deque[Any] = deque()
        self._turn: Callable[[], None] = lambda: None
        self._skipped_s = float("-inf")

    @property
    def warning(self) -> str:
        """What to warn of for a while after something was left out; else empty."""
        recent = time.monotonic() - self._skipped_s < WARNED_S
        return f"too slow for all that comes: some is left out, see '{SKIPPED}'" if recent else ""

    def subscribe(
        self,
        kind: type,
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile | int,
        left_out: Callable[[Any], None] = lambda _: None,
    ) -> None:
        """As `create_subscription`, for one topic; `left_out` is told of each message that is not worked off."""
        if not self._most:
            self._node.create_subscription(kind, topic, callback, qos)
            return
        subscription = self._node.create_subscription(kind, topic, self._came, qos)

        def turn() -> None:
            self._waiting.extend(_come(subscription))
            while len(self._waiting) > 1 + self._most:
                self._skipped_s = time.monotonic()
                self._diagnostics.count(SKIPPED)
                left_out(self._waiting.popleft())
            callback(self._waiting.popleft())

        self._turn = turn

    def _came(self, message: Any) -> None:
        self._waiting.append(message)

    def work(self) -> Iterator[float]:
        """Work off what waits, one message each time."""
        while True:
            if self._waiting:
                self._turn()
            yield from itertools.repeat(0.0, EVENTS) if self._waiting else (TURN_S,)


def _come(subscription: Subscription) -> Iterator[Any]:
    """All messages that have come and were not handed out yet."""
    with contextlib.suppress(InvalidHandle), subscription.handle:  # invalid if another node here calls in its place
        while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            yield taken[0]
