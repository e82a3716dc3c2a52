"""Listens to what nodes of one ROS domain publish, while a test does something to them."""

from __future__ import annotations

import threading
import time
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rgbd_dic_acquisition.messages import stamp_to_ns


class GraphEar:
    """Keeps when each message of some topics came, with its stamp, and what one node says of itself.

    Attributes:
        heard: topic -> [(arrival by the steady clock [s], stamp [ns])].
        said: [(arrival by the steady clock [s], level, message, values)] of the node on /diagnostics.
    """

    def __init__(self, domain: int, node: str, topics: dict[str, type]) -> None:
        self.heard: dict[str, list[tuple[float, int]]] = {topic: [] for topic in topics}
        self.said: list[tuple[float, int, str, dict[str, str]]] = []
        self._name = f"/{node}"
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("ear", context=self._context)
        for topic, kind in topics.items():
            self._node.create_subscription(kind, topic, self._hearer(topic), 100)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 100)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin)

    def __enter__(self) -> GraphEar:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    @property
    def level(self) -> int:
        """The node's latest level: 0 OK, 1 WARN; -1 if it has said nothing yet."""
        return self.said[-1][1] if self.said else -1

    @property
    def message(self) -> str:
        return self.said[-1][2] if self.said else ""

    @property
    def values(self) -> dict[str, str]:
        return self.said[-1][3] if self.said else {}

    def _hearer(self, topic: str) -> Any:
        return lambda message: self.heard[topic].append((time.monotonic(), stamp_to_ns(message.header.stamp)))

    def _take(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._name:
                values = {pair.key: pair.value for pair in status.values}
                self.said.append((time.monotonic(), status.level[0], status.message, values))

    def _spin(self) -> None:
        while not self._ended.is_set():
            self._executor.spin_once(timeout_sec=0.05)
