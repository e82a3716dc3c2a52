"""What viewers ask of the graph: services called, events published, an image fetched to draw on."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from queue import Empty
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_acquisition.messages import header_message, image_from_message, image_message, stamp_to_ns
from rgbd_dic_acquisition.nodes.diagnostics import WatchedPublisher
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, make
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import SetBool, Trigger

from rgbd_dic_msgs.msg import Event, PlaneStamped, Reference
from rgbd_dic_msgs.srv import SetRegions

from ..core.regions_file import text_of
from ..core.settings import ProcessingSettings
from ..pages.drawing import Drawing
from ..pages.live_state import LiveState, Order
from .messages import plane_from_message, reference_from_message

IMAGE_TIMEOUT_S, PLANE_TIMEOUT_S = 5.0, 1.0
PLANE_NEAR_S = 0.1  # between the image to draw on and the plane that its sizes are measured on


@dataclass
class Fetching:
    """An image on its way to be drawn on, with its calibration and a plane near it."""

    order: Order
    begun_s: float = field(default_factory=time.monotonic)
    image: Image | None = None
    info: CameraInfo | None = None
    reference: Reference | None = None
    planes: list[PlaneStamped] = field(default_factory=list)
    heard: list[Subscription] = field(default_factory=list)


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
        self._fetching: Fetching | None = None
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
            self._look_at_fetching(self._fetching)

    def _call(self, order: Order, client: Any, request: Any, node: str) -> None:
        if not client.service_is_ready():
            order.done.set_exception(RgbdDicError(f"{node} is not running, or has no service {client.srv_name}"))
            return

        def answered(future: Future) -> None:
            answer = future.result()
            if answer.success:
                order.done.set_result(answer.message)
            else:
                order.done.set_exception(RgbdDicError(answer.message))

        client.call_async(request).add_done_callback(answered)

    def _mark(self, order: Order) -> None:
        stamp_ns = self._state.last_stamp_ns() or self._node.get_clock().now().nanoseconds
        self._events.publish(Event(header=header_message(make, stamp_ns, ""), text=order.content))
        self._state.add_event(stamp_ns, order.content)
        order.done.set_result(f"marked: {order.content}")

    def _send_regions(self, order: Order) -> None:
        entries, drawing = order.content
        image = image_message(make, drawing.stamp_ns, drawing.frame_id, drawing.image, "mono8")
        request = SetRegions.Request(regions=text_of(entries), image=image)
        self._call(order, self._set_regions, request, "dic_node")

    def _fetch(self, order: Order) -> None:
        if self._fetching is not None:
            order.done.set_exception(RgbdDicError("an image is being fetched already: ask again in a moment"))
            return
        fetching = self._fetching = Fetching(order)
        latest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        for kind, topic, take in (
            (Image, "camera/image_raw", lambda message: setattr(fetching, "image", fetching.image or message)),
            (CameraInfo, "camera/camera_info", lambda message: setattr(fetching, "info", message)),
            (PlaneStamped, "plane", fetching.planes.append),
        ):
            fetching.heard.append(self._node.create_subscription(kind, topic, take, latest))
        take = partial(setattr, fetching, "reference")
        fetching.heard.append(self._node.create_subscription(Reference, "reference", take, latched_qos()))

    def _look_at_fetching(self, fetching: Fetching) -> None:
        waited_s = time.monotonic() - fetching.begun_s
        if fetching.image is None:
            if waited_s > IMAGE_TIMEOUT_S:
                self._end_fetching(RgbdDicError(f"no image came within {IMAGE_TIMEOUT_S:g} s: is the camera running?"))
            return
        stamp_ns = stamp_to_ns(fetching.image.header.stamp)
        away = {abs(stamp_to_ns(p.header.stamp) - stamp_ns): p for p in fetching.planes if p.status.value == 0}
        nearest = min(away, default=None)
        near = nearest is not None and nearest <= PLANE_NEAR_S * 1e9
        if waited_s < PLANE_TIMEOUT_S and (not near or (self._camera() is None and fetching.info is None)):
            return
        try:
            camera = self._camera() or (Camera.from_camera_info(fetching.info) if fetching.info else None)
            image = image_from_message(fetching.image)
            plane = plane_from_message(away[nearest]).plane if near and camera is not None else None
            drawing = Drawing(
                f"live image of {stamp_ns * 1e-9:.3f} s", stamp_ns, image, self._settings, self._noise, camera,
                plane=plane, no_depth="no plane of the panel came near the image",
            )  # fmt: skip
            drawing.frame_id = fetching.image.header.frame_id
            self._end_fetching(drawing)
        except RgbdDicError as error:
            self._end_fetching(error)

    def _end_fetching(self, result: Drawing | RgbdDicError) -> None:
        fetching, self._fetching = self._fetching, None
        for subscription in fetching.heard:
            self._node.destroy_subscription(subscription)
        if isinstance(result, RgbdDicError):
            fetching.order.done.set_exception(result)
        else:
            regions = reference_from_message(fetching.reference).regions if fetching.reference else None
            fetching.order.done.set_result((result, dict(regions.entries) if regions else {}))


class LiveGraph:
    """The running graph, for the regions page."""

    def __init__(self, state: LiveState):
        self._state = state

    async def drawing(self) -> tuple[Drawing, dict[str, Any]]:
        return await self._state.order("drawing")

    async def set_regions(self, entries: Mapping[str, Any], drawing: Drawing) -> str:
        return await self._state.order("regions", (entries, drawing))
