"""What was measured while nobody looked at the live page."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.task import Future

from rgbd_dic_msgs.srv import OpeningHistory

from ..pages.live_state import LiveState
from .messages import openings_from_history


class LiveHistory:
    """Asks crack_opening_node for the whole flight, once for each time that somebody begins to look."""

    def __init__(self, node: Node, state: LiveState):
        self._state, self._due = state, False
        self._client = node.create_client(OpeningHistory, "crack_opening_node/history")

    def ask(self) -> None:
        self._due = True

    def turn(self) -> None:
        """Called often: ask as soon as there is somebody to answer."""
        if self._due and self._client.service_is_ready():
            self._due = False
            self._client.call_async(OpeningHistory.Request()).add_done_callback(self._answered)

    def _answered(self, answer: Future) -> None:
        self._state.fill(openings_from_history(answer.result()))
