"""The eye of `rgbd-dic up` on a running graph: is it connected, and what does it publish."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_acquisition.nodes.diagnostics import matched_subscriptions
from rgbd_dic_acquisition.nodes.spinning import prepare_process
from rgbd_dic_acquisition.nodes.strangers import strangers

from rgbd_dic_msgs.msg import CrackOpening as CrackOpeningMessage

from .core.crack import CrackOpening
from .graph import NodeSpec, takers
from .nodes.inputs import STREAM_DEPTH
from .nodes.messages import crack_opening_from_message

CONNECT_TIMEOUT_S = 60.0


class GraphWatch:
    """Subscribes the openings and the diagnostics; a context manager around rclpy.

    Attributes:
        openings: all that were published, in the order of arrival.
        first_heard, last_heard: steady time of the first and the last of them [s].
    """

    def __init__(
        self,
        topics: dict[str, str],
        namespace: str,
        on_opening: Callable[[CrackOpening], None],
        on_state: Callable[[str, str], None] = lambda node, warning: None,
    ):
        """
        Args:
            topics: method -> topic of its openings.
            on_state: told a node's name and its warning, empty if all is well, each time that one says how it is.
        """
        prepare_process()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.openings: list[CrackOpening] = []
        self.first_heard = self.last_heard = time.monotonic()
        self._topics, self._on_opening, self._on_state = topics, on_opening, on_state
        self._node = Node("rgbd_dic_up", namespace=namespace or None)
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        self._matched: dict[tuple[str, str], int] = {}

    def refuse_second_graph(self, nodes: list[NodeSpec], settle_s: float = 2.0) -> None:
        """Raise if nodes of these names run in this ROS domain already: two graphs would mix their topics."""
        self.spin(settle_s)
        running = {name for name, _ in self._node.get_node_names_and_namespaces()}
        taken = sorted(running & {node.node_name for node in nodes})
        if taken:
            raise RgbdDicError(
                f"{', '.join(taken)} already run in ROS domain {os.environ.get('ROS_DOMAIN_ID', '0')}: end them, or "
                "choose another domain with --domain"
            )

    def subscribe(self) -> None:
        """From now on, listen to the openings and the diagnostics."""
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnostics, STREAM_DEPTH)
        for topic in self._topics.values():
            self._node.create_subscription(CrackOpeningMessage, topic, self._opening, 10 * STREAM_DEPTH)

    def wait_until_connected(self, nodes: list[NodeSpec], check: Callable[[], None]) -> None:
        """Wait until every topic that these nodes give to each other has reached all of its subscriptions.

        Raises:
            RgbdDicError: if a node ends (from `check`), or it takes too long, naming what is not connected.
        """
        expected = takers(nodes)
        for topic in self._topics.values():
            expected[topic].append(self._node.get_name())
        wanted = [(node.node_name, topic, expected[topic]) for node in nodes for topic in node.gives]
        deadline = time.monotonic() + CONNECT_TIMEOUT_S
        while missing := [(name, topic) for name, topic, known in wanted if self._lacks(name, topic, known)]:
            check()
            if time.monotonic() > deadline:
                raise RgbdDicError(
                    f"the graph is not connected after {CONNECT_TIMEOUT_S:.0f} s: "
                    + ", ".join(f"{name} {topic}" for name, topic in missing)
                )
            self.spin(0.1)

    def _lacks(self, name: str, topic: str, known: list[str]) -> bool:
        topic = self._absolute(topic)
        matched = self._matched.get((self._absolute(name), topic), 0)
        return matched < len(known) + strangers(self._node, name, topic, known)

    def spin(self, duration_s: float) -> None:
        """Handle what arrives for a while."""
        end = time.monotonic() + duration_s
        while (rest := end - time.monotonic()) > 0 and rclpy.ok():
            try:
                self._executor.spin_once(timeout_sec=rest)
            except ExternalShutdownException:
                return

    def _opening(self, message: CrackOpeningMessage) -> None:
        opening = crack_opening_from_message(message)
        self.last_heard = time.monotonic()
        if not self.openings:
            self.first_heard = self.last_heard
        self.openings.append(opening)
        self._on_opening(opening)

    def _diagnostics(self, message: DiagnosticArray) -> None:
        self._matched.update(matched_subscriptions(message))
        for status in message.status:
            if ": " not in status.name:
                well = status.level == DiagnosticStatus.OK
                self._on_state(status.name.rsplit("/", 1)[-1], "" if well else status.message)

    def _absolute(self, name: str) -> str:
        return f"{self._node.get_namespace().rstrip('/')}/{name}"

    def __enter__(self) -> GraphWatch:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.remove_node(self._node)
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown()
