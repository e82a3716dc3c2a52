"""operator_node: the live page in a browser; it hears the graph only while somebody looks."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rgbd_dic_acquisition.calibration import Camera, load_calibration
from rgbd_dic_acquisition.errors import CalibrationError
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare, declare_path
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos
from rgbd_dic_acquisition.nodes.spinning import run
from sensor_msgs.msg import CameraInfo

from rgbd_dic_msgs.msg import CrackOpening, Event, Reference

from ..core.correlation import CorrelationSettings
from ..core.settings import CompensationSettings, CrackSettings, PlaneSettings, ProcessingSettings
from ..pages.access import Access
from ..pages.live_page import LivePage
from ..pages.live_state import LiveState
from ..pages.regions_page import RegionsPage
from ..pages.server import ServerThread, make_app
from ..pages.settings import OperatorSettings
from .inputs import STREAM_DEPTH
from .live_history import LiveHistory
from .live_orders import LiveOrders
from .live_pictures import LivePictures
from .messages import crack_opening_from_message, reference_from_message
from .node_states import node_states
from .shelf import Shelf

WATCHED_S, IDLE_S = 0.1, 0.2  # longest wait between two turns
OPENINGS_DEPTH = 300  # openings that may come between two turns
OFFERS_S = 1.0
NICENESS = 10  # the measurement goes first


class OperatorNode(Node):
    """Args: announce: told the address of the page, once it is served."""

    def __init__(self, announce: Callable[[str], None] | None = None) -> None:
        super().__init__("operator_node")
        self._settings = declare(self, OperatorSettings, "operator")
        processing = ProcessingSettings(
            correlation=declare(self, CorrelationSettings, "correlation"),
            plane=declare(self, PlaneSettings, "plane"),
            compensation=declare(self, CompensationSettings, "compensation"),
            crack=declare(self, CrackSettings, "crack"),
        )
        path = declare_path(self, "calibration_file", "calibration.yaml; camera_info is used if empty", False)
        out = declare_path(
            self, "regions_out", "the regions.yaml that the page saves; regions.yaml where it runs if empty", False
        )
        self._camera: Camera | None = load_calibration(path).camera if path else None
        self._diagnostics = Diagnostics(self)
        self._state = LiveState(self._settings.most_viewers)
        self._pictures = LivePictures(self, self._state, self._settings.picture_quality)
        self._pictures.camera = self._camera
        events = self._diagnostics.watch(self.create_publisher(Event, "event", 10))
        self._orders = LiveOrders(self, self._state, processing, self._settings.noise, lambda: self._camera, events)
        self._history = LiveHistory(self, self._state)
        self._openings = Shelf(self, CrackOpening, "crack_opening", OPENINGS_DEPTH)
        self._heard, self._info = [], None
        self._offers_due_s = 0.0
        access = Access.on(self._settings.host, self._settings.port)
        regions = RegionsPage(None, out or Path("regions.yaml"), {}, self._orders.live)
        routes = [*LivePage(self._state).routes(), *regions.routes()]
        self._server = ServerThread(make_app(access, routes, start="/live"), access, announce or self._announce)

    def work(self) -> Iterator[float]:
        """Hear as much as is looked at, and do what is ordered."""
        while True:
            self._server.check()
            watched = self._state.watched(self._settings.linger_s)
            if watched != bool(self._heard):
                self._listen() if watched else self._rest()
            if self._camera is not None:
                self._forget_info()
            for message in self._openings.taken():
                self._state.add_opening(crack_opening_from_message(message))
            self._history.turn()
            self._pictures.turn(watched)
            self._orders.turn()
            if watched and time.monotonic() >= self._offers_due_s:
                self._offers_due_s = time.monotonic() + OFFERS_S
                self._state.set_offers(self._orders.offers())
            yield WATCHED_S if watched or self._orders.busy else IDLE_S

    def close(self) -> None:
        self._server.close()
        self._rest()
        self._openings.close()

    def _listen(self) -> None:
        streams: list[tuple[type, str, Callable, object]] = [
            (DiagnosticArray, "/diagnostics", self._states, STREAM_DEPTH),
            (Reference, "reference", self._reference, latched_qos()),
        ]
        self._heard = [self.create_subscription(*stream) for stream in streams]
        self._openings.listen()
        self._history.ask()
        if self._camera is None:
            qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            self._info = self.create_subscription(CameraInfo, "camera/camera_info", self._camera_info, qos)

    def _rest(self) -> None:
        self._forget_info()
        self._openings.rest()
        for subscription in self._heard:
            self.destroy_subscription(subscription)
        self._heard = []

    def _forget_info(self) -> None:
        if self._info is not None:
            self.destroy_subscription(self._info)
            self._info = None

    def _states(self, message: DiagnosticArray) -> None:
        for name, state in node_states(message, self.get_namespace()).items():
            if name != self.get_name():
                self._state.set_node(name, state)

    def _reference(self, message: Reference) -> None:
        self._pictures.regions = reference_from_message(message).regions

    def _camera_info(self, message: CameraInfo) -> None:
        if self._camera is None:
            try:
                self._camera = self._pictures.camera = Camera.from_camera_info(message)
            except CalibrationError as error:
                self._diagnostics.warn(str(error))

    def _announce(self, address: str) -> None:
        self.get_logger().info(f"open {address}")


def main(args: Sequence[str] | None = None, announce: Callable[[str], None] | None = None) -> int:
    os.nice(NICENESS)
    return run(partial(OperatorNode, announce), args)
