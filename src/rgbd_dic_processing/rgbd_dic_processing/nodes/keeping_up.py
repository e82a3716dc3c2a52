"""What a node does with messages that come faster than it works: it works on the newest, and says what it left out."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare
from rgbd_dic_acquisition.nodes.raw_taking import RawTaking
from rgbd_dic_acquisition.nodes.spinning import TURN_S
from rgbd_dic_acquisition.settings import Settings, setting

SKIPPED = "skipped"  # counter on /diagnostics
WARNED_S = 2.0  # after a message was left out
CAUGHT_UP_S = 1.0  # after a message was left out: none waits any more until so long nothing had to be left out


@dataclass(frozen=True)
class KeepUpSettings(Settings):
    """What becomes of messages that come faster than a node works."""

    max_waiting: int = setting(
        0,
        unit="messages",
        low=0,
        high=1000,
        doc="so many may wait while a node is held up; when more do, all but the newest are left out until it has kept "
        "up for a second, so that latency does not grow; 0: none is left out",
    )


class KeepUp:
    """Subscribes so that a slow node stays up to date: when a message's turn has come, all that came meanwhile is
    looked at. While more than `max_waiting` wait behind it, it is left out and counted, and the next one's turn has
    come; from then on it is so as soon as one waits, for what waits makes nothing but latency where a node is too slow.
    A node that takes twice as long as messages need to come so works off every second one, as soon as it came.

    The node's `work` must be this one's.
    """

    def __init__(self, node: Node, diagnostics: Diagnostics):
        self._node, self._diagnostics = node, diagnostics
        self._most = declare(node, KeepUpSettings, "keep_up").max_waiting
        self._waiting: deque[Any] = deque()
        self._turn: Callable[[], None] = lambda: None
        self._skipped_s = float("-inf")

    @property
    def leaves_out(self) -> bool:
        """Whether messages are left out when they come too fast."""
        return self._most > 0

    @property
    def warning(self) -> str:
        """What to warn of for a while after something was left out; else empty."""
        recent = self._skipped_within(WARNED_S)
        return f"too slow for all that comes: some is left out, see '{SKIPPED}'" if recent else ""

    def _skipped_within(self, period_s: float) -> bool:
        return time.monotonic() - self._skipped_s < period_s

    def subscribe(
        self,
        kind: type,
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile | int,
        left_out: Callable[[Any], None] = lambda _: None,
        raw: bool = False,
    ) -> None:
        """As `create_subscription`, for one topic; `left_out` is told of each message that is not worked off.

        raw: messages are their serialised bytes, so that a large one that is left out costs a copy and no more.
        """
        if not self.leaves_out:
            self._node.create_subscription(kind, topic, callback, qos, raw=raw)
            return
        subscription = self._node.create_subscription(kind, topic, self._came, qos, raw=raw)
        newer = partial(_come_raw, RawTaking(), subscription) if raw else partial(come, subscription)

        def turn() -> None:
            self._waiting.extend(newer())
            while len(self._waiting) > 1 + (0 if self._skipped_within(CAUGHT_UP_S) else self._most):
                self._skipped_s = time.monotonic()
                self._diagnostics.count(SKIPPED)
                left_out(self._waiting.popleft())
            callback(self._waiting.popleft())

        self._turn = turn

    def _came(self, message: Any) -> None:
        self._waiting.append(message)

    def work(self) -> Iterator[float]:
        """Work off what waits: each time as many messages as waited at its beginning, or fewer if some are left out."""
        while True:
            for _ in range(len(self._waiting)):
                if self._waiting:
                    self._turn()
            yield 0.0 if self._waiting else TURN_S


def come(subscription: Subscription) -> Iterator[Any]:
    """All messages that have come and were not handed out yet."""
    with contextlib.suppress(InvalidHandle), subscription.handle:  # invalid if another node here calls in its place
        while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            yield taken[0]


def _come_raw(taking: RawTaking, subscription: Subscription) -> Iterator[bytes]:
    """The same of a raw subscription, with a copy less than rclpy makes."""
    with contextlib.suppress(InvalidHandle):
        while (taken := taking.take(subscription)) is not None:
            yield taken.data
