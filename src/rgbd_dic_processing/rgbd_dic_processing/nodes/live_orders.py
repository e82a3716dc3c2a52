"""What viewers ask of the graph: services called, events published, an image fetched to draw on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from queue import Empty
from typing import Any

from rclpy.node import Node
from rclpy.task import Future
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_acquisition.messages import header_message, image_message
from rgbd_dic_acquisition.nodes.diagnostics import WatchedPublisher
from rgbd_dic_acquisition.nodes.ros_messages import make
from std_srvs.srv import SetBool, Trigger

from rgbd_dic_msgs.msg import Event
from rgbd_dic_msgs.srv import SetRegions

from ..core.regions_file import text_of
from ..core.settings import ProcessingSettings
from ..pages.drawing import Drawing
from ..pages.live_state import LiveState, Order
from .live_drawing import DrawingFetch


class LiveOrders:
    """Carries out the orders of a LiveState, in the thread of the executor.

    Attributes:
        live: what the regions page asks.
    """

    def __init__(
        self,
        node: Node,
        state: LiveState,
        settings: ProcessingSettings,
        noise: float,
        camera: Callable[[], Camera | None],
        events: WatchedPublisher,
    ):
        self._node, self._state, self._noise, self._camera = node, state, noise, camera
        self._settings = replace(settings, correlation=replace(settings.correlation, threads=1))
        self._set_reference = node.create_client(Trigger, "dic_node/set_reference")
        self._set_regions = node.create_client(SetRegions, "dic_node/set_regions")
        self._record = node.create_client(SetBool, "recorder_node/record")
        self._events = events
        self._fetching: tuple[Order, DrawingFetch] | None = None
        self.live = LiveGraph(state)
        self._done = {
            "reference": lambda order: self._call(order, self._set_reference, Trigger.Request(), "dic_node"),
            "recording": lambda order: self._call(
                order, self._record, SetBool.Request(data=order.content), "recorder_node"
            ),
            "regions": self._send_regions,
            "event": self._mark,
            "drawing": self._fetch,
        }

    @property
    def busy(self) -> bool:
        return self._fetching is not None

    def offers(self) -> dict[str, bool]:
        """What the graph can be asked for at present."""
        return {
            "reference": self._set_reference.service_is_ready(),
            "regions": self._set_regions.service_is_ready(),
            "recording": self._record.service_is_ready(),
        }

    def turn(self) -> None:
        """Called often: take new orders, and look whether the image has come."""
        try:
            while True:
                order = self._state.orders.get_nowait()
                self._done[order.what](order)
        except Empty:
            pass
        if self._fetching is not None:
            self._look_at_fetch(*self._fetching)

    def _call(self, order: Order, client: Any, request: Any, node: str) -> None:
        if not client.service_is_ready():
            order.answer(RgbdDicError(f"{node} is not running, or has no service {client.srv_name}"))
            return

        def answered(future: Future) -> None:
            answer = future.result()
            order.answer(answer.message if answer.success else RgbdDicError(answer.message))

        client.call_async(request).add_done_callback(answered)

    def _mark(self, order: Order) -> None:
        stamp_ns = self._state.last_stamp_ns() or self._node.get_clock().now().nanoseconds
        self._events.publish(Event(header=header_message(make, stamp_ns, ""), text=order.content))
        self._state.add_event(stamp_ns, order.content)
        order.answer(f"marked: {order.content}")

    def _send_regions(self, order: Order) -> None:
        entries, drawing = order.content
        image = image_message(make, drawing.stamp_ns, drawing.frame_id, drawing.image, "mono8")
        request = SetRegions.Request(regions=text_of(entries), image=image)
        self._call(order, self._set_regions, request, "dic_node")

    def _fetch(self, order: Order) -> None:
        if self._fetching is not None:
            order.answer(RgbdDicError("an image is being fetched already: ask again in a moment"))
        else:
            self._fetching = order, DrawingFetch(self._node, self._camera())

    def _look_at_fetch(self, order: Order, fetch: DrawingFetch) -> None:
        try:
            result = fetch.result(self._settings, self._noise)
        except RgbdDicError as error:
            result = error
        if result is not None:
            self._fetching = None
            fetch.close()
            order.answer(result)


class LiveGraph:
    """The running graph, for the regions page."""

    def __init__(self, state: LiveState):
        self._state = state

    async def drawing(self) -> tuple[Drawing, dict[str, Any]]:
        return await self._state.order("drawing", timeout_s=20.0)

    async def set_regions(self, entries: Mapping[str, Any], drawing: Drawing) -> str:
        return await self._state.order("regions", (entries, drawing))
