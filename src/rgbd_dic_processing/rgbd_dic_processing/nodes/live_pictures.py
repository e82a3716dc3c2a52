"""The pictures of the live page: a few images a second, with the regions where the motion has carried them."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import ImageError
from rgbd_dic_acquisition.in_flight import header_stamp_ns
from rgbd_dic_acquisition.messages import image_from_message
from sensor_msgs.msg import Image

from rgbd_dic_msgs.msg import SubsetField

from ..core.carried_regions import carried_regions
from ..core.regions import Regions
from ..pages.live_state import LiveState, Picture
from ..pages.settings import OperatorSettings
from .inputs import STREAM_DEPTH
from .messages import subset_field_from_message

PATIENCE_S = 1.5  # a picture whose subset field has not come in this time is shown without outlines
MOST_WAITING = 8


@dataclass(frozen=True)
class WaitingPicture:
    """A picture, made small, that waits for where the subsets are in it."""

    stamp_ns: int
    taken_s: float
    width: int
    height: int
    small: NDArray[np.uint8]


class LivePictures:
    """Takes the newest image when a picture is due; the images between cost nothing here but their way through DDS.

    Attributes:
        regions, camera: what the outlines follow from; None until they are known.
        newest: serialised image of the last picture, to draw regions on; None before.
    """

    def __init__(self, node: Node, state: LiveState, settings: OperatorSettings):
        self._node, self._state, self._settings = node, state, settings
        # A node that no executor spins: its images are fetched, not delivered.
        self._shelf = Node(
            "operator_pictures", context=node.context, namespace=node.get_namespace(), use_global_arguments=False
        )
        self._images: Subscription | None = None
        self._fields: Subscription | None = None
        self._waiting: deque[WaitingPicture] = deque(maxlen=MOST_WAITING)
        self._due_s, self._number = 0.0, 0
        self.regions: Regions | None = None
        self.camera: Camera | None = None
        self.newest: bytes | None = None

    def turn(self) -> None:
        """Called often: subscribe while pictures are wanted, and take one when it is due."""
        if not self._state.picture_wanted():
            self.stop()
            return
        if self._images is None:
            latest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
            topic = self._node.resolve_topic_name("camera/image_raw")
            self._images = self._shelf.create_subscription(Image, topic, lambda _: None, latest)
            fields = QoSProfile(depth=STREAM_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
            self._fields = self._node.create_subscription(SubsetField, "subset_field", self._field, fields, raw=True)
        now = time.monotonic()
        while self._waiting and now - self._waiting[0].taken_s > PATIENCE_S:
            self._show(self._waiting.popleft(), {}, "it is not measured yet")
        if now >= self._due_s and (taken := _take(self._images)) is not None:
            self._due_s = now + 1 / self._settings.picture_rate_hz
            self._keep(taken)

    def stop(self) -> None:
        """Hear nothing any more."""
        if self._images is not None:
            self._shelf.destroy_subscription(self._images)
            self._node.destroy_subscription(self._fields)
            self._images = self._fields = None
            self._waiting.clear()

    def close(self) -> None:
        self.stop()
        self._shelf.destroy_node()

    def _keep(self, taken: bytes) -> None:
        self.newest = taken
        try:
            image = image_from_message(deserialize_message(taken, Image))
        except ImageError:
            return
        height, width = image.shape
        if image.dtype != np.uint8:
            image = (image >> 8).astype(np.uint8)
        scale = min(1.0, self._settings.picture_width_px / width)
        size = (round(width * scale), round(height * scale))
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if scale < 1 else image.copy()
        self._waiting.append(WaitingPicture(header_stamp_ns(taken), time.monotonic(), width, height, small))

    def _field(self, data: bytes) -> None:
        stamp_ns = header_stamp_ns(data)
        picture = next((waiting for waiting in self._waiting if waiting.stamp_ns == stamp_ns), None)
        if picture is None:
            return
        while self._waiting and self._waiting.popleft() is not picture:
            pass
        field = subset_field_from_message(deserialize_message(data, SubsetField))
        outlines = {}
        if field.view is not None and self.regions is not None and self.camera is not None:
            carried = carried_regions(self.regions, self.camera, field.view)
            outlines = {name: [np.round(p, 1).tolist() for p in polygons] for name, polygons in carried.items()}
        self._show(picture, outlines, field.reason)

    def _show(self, waiting: WaitingPicture, outlines: dict, reason: str) -> None:
        self._number += 1
        quality = [cv2.IMWRITE_JPEG_QUALITY, self._settings.picture_quality]
        jpeg = cv2.imencode(".jpg", waiting.small, quality)[1].tobytes()
        about = (waiting.stamp_ns, waiting.width, waiting.height)
        self._state.set_picture(Picture(self._number, *about, jpeg, outlines, reason))


def _take(subscription: Subscription) -> bytes | None:
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, True)
    return None if taken is None else taken[0]
