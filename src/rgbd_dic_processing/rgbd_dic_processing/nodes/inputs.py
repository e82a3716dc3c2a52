"""What several nodes take in the same way: the camera's calibration, and the end of a stream."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rgbd_dic_acquisition.calibration import Calibration, Camera, load_calibration
from rgbd_dic_acquisition.errors import CalibrationError
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare, declare_path
from rgbd_dic_acquisition.nodes.ros_messages import QosSettings, image_qos
from rgbd_dic_acquisition.settings import setting
from sensor_msgs.msg import CameraInfo

STREAM_DEPTH = 100  # messages that a slow node may lag behind a reliable stream


@dataclass(frozen=True)
class SensorQosSettings(QosSettings):
    """How the topics of the sensors are subscribed; a reliable subscription does not hear a best-effort driver."""

    depth: int = setting(STREAM_DEPTH, doc="frames kept while the node is busy", unit="frames", low=1, high=1000)


def sensor_qos(node: Node) -> QoSProfile:
    """The parameters `sensor_qos.*` as a profile."""
    return image_qos(declare(node, SensorQosSettings, "sensor_qos"))


class CameraInput:
    """The camera's intrinsics: from `calibration_file`, or, without one, from `camera/camera_info`.

    The file wins; a CameraInfo that differs from it is warned about where the two are to be compared. `on_camera` is
    called once. The first good CameraInfo is the last that is heard: sixty a second would be work for nothing.
    """

    def __init__(
        self,
        node: Node,
        diagnostics: Diagnostics,
        qos: QoSProfile,
        on_camera: Callable[[Camera], None],
        compares: bool = False,
    ):
        self._node, self._diagnostics, self._on_camera = node, diagnostics, on_camera
        path = declare_path(node, "calibration_file", "calibration.yaml; camera_info is used if empty", required=False)
        self.calibration: Calibration | None = load_calibration(path) if path else None
        self.camera: Camera | None = None
        self._heard: Subscription | None = None
        if compares or self.calibration is None:
            self._heard = node.create_subscription(CameraInfo, "camera/camera_info", self._camera_info, qos, raw=True)
        if self.calibration is not None:
            self._take(self.calibration.camera)

    def _camera_info(self, serialised: bytes) -> None:
        if self._heard is None:
            return
        info = deserialize_message(serialised, CameraInfo)
        try:
            seen = Camera.from_camera_info(info)
        except CalibrationError as error:
            if self.camera is None:
                self._diagnostics.warn(str(error))
            return
        self._node.destroy_subscription(self._heard)
        self._heard = None
        if self.camera is None:
            self._take(seen)
        elif not seen.agrees_with(self.camera):
            self._diagnostics.count("camera_info that differs from calibration_file")
            self._node.get_logger().warning("camera/camera_info differs from calibration_file; the file is used")

    def _take(self, camera: Camera) -> None:
        self.camera = camera
        self._on_camera(camera)


Known = TypeVar("Known")


class OfReference(Generic[Known]):
    """Hands fields on with what is known of the reference that they count from, in their order.

    Fields and references come on topics of their own. Once one reference is known, a field of a later one waits for it;
    before, fields are handed on with None, as in a graph whose references nobody publishes.
    """

    KEPT = 64  # references; fields of older ones are no longer under way

    def __init__(self, hand_on: Callable[[Any, Known | None], None]):
        self._hand_on = hand_on
        self._known: dict[int, Known] = {}
        self._waiting: deque[Any] = deque(maxlen=STREAM_DEPTH)

    def know(self, stamp_ns: int, known: Known) -> None:
        """A reference was taken."""
        self._known[stamp_ns] = known
        while len(self._known) > self.KEPT:
            self._known.pop(next(iter(self._known)))
        self._settle()

    def add(self, field: Any) -> None:
        """A SubsetField or DisplacementField."""
        self._waiting.append(field)
        self._settle()

    def _settle(self) -> None:
        while self._waiting:
            stamp_ns = self._waiting[0].reference_stamp_ns
            if self._known and stamp_ns > max(self._known):
                return
            self._hand_on(self._waiting.popleft(), self._known.get(stamp_ns))


class IdleFlush:
    """Calls `flush` once when a stream has ended, so that what still waits for more is settled.

    A stream has ended when nothing has come for a while; in a replay, moreover, only when the player has taken down
    /clock, as it does after its last message. A slow node that keeps the others idle does not end a replay.
    """

    IDLE_S = 2.0
    AFTER_OTHERS_S = 3.0  # for a node that is fed by nodes which flush too: what they settle comes first

    def __init__(self, node: Node, flush: Callable[[], None], idle_s: float = IDLE_S):
        self._node, self._flush, self._idle_s, self._last, self._pending = node, flush, idle_s, 0.0, False
        self._replay = node.get_parameter("use_sim_time").value
        self._timer = node.create_timer(0.25, self._check, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def touch(self) -> None:
        """Something came."""
        self._last, self._pending = time.monotonic(), True

    def _check(self) -> None:
        if not self._pending or time.monotonic() - self._last < self._idle_s:
            return
        if self._replay and self._node.count_publishers("/clock"):
            return
        self._pending = False
        self._flush()
