"""Small pictures of what dic_node measures, and the displacements of the same images: for the live page and viewers."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rgbd_dic_acquisition.messages import header_message, image_message, stamp_to_ns
from rgbd_dic_acquisition.nodes.ros_messages import make
from rgbd_dic_acquisition.settings import Settings, setting
from std_msgs.msg import Header

from rgbd_dic_msgs.msg import DisplacementField, FrameStatus, Preview

from ..core.subset_field import SubsetField
from ..core.view import made_small
from ..view_topics import PREVIEWED_FIELD
from .same_stamp import SameStamp

# Hidden: no recorder takes them for a part of the measurement.
TOPIC = "_preview"
ANNOUNCED = "_previewed"  # header of each image that has a preview
ANNOUNCED_DEPTH = 10
FIELDS_KEPT = 8  # until it is known whether they have a preview


@dataclass(frozen=True)
class PreviewSettings(Settings):
    """Small pictures for the live page and for viewers; none are made while nobody looks."""

    rate_hz: float = setting(4.0, unit="1/s", low=0.1, high=30.0, doc="most pictures that are made a second")
    width_px: int = setting(800, unit="px", low=80, high=4096, doc="largest width of a picture")


def preview_qos() -> QoSProfile:
    """The newest picture, or none."""
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class PreviewOutput:
    """Publishes a picture now and then, while somebody listens."""

    def __init__(self, node: Node, settings: PreviewSettings):
        self._settings, self._due_s = settings, 0.0
        self._output = node.create_publisher(Preview, TOPIC, preview_qos())
        self._announced = node.create_publisher(Header, ANNOUNCED, ANNOUNCED_DEPTH)

    def offer(self, image: NDArray[np.uint8], field: SubsetField, frame_id: str) -> None:
        """An image (rows, cols), mono8, and where the subsets are in it."""
        now = time.monotonic()
        if now < self._due_s or not self._output.get_subscription_count():
            return
        self._due_s = now + 1 / self._settings.rate_hz
        header = header_message(make, field.stamp_ns, frame_id)
        self._announced.publish(header)
        height, width = image.shape
        small = made_small(image, self._settings.width_px)
        self._output.publish(
            Preview(
                header=header,
                width=width,
                height=height,
                small=image_message(make, field.stamp_ns, frame_id, small, "mono8"),
                status=FrameStatus(value=int(field.status)),
                reason=field.reason,
                homography=field.homography.ravel(),
            )
        )


class PreviewedFields:
    """Publishes the displacement fields of the images that have a preview, while somebody listens: who watches need not
    take all fields, of which there are sixty a second, to have those four."""

    def __init__(self, node: Node):
        self._together = SameStamp("announced", {"field": FIELDS_KEPT})
        self._output = node.create_publisher(DisplacementField, PREVIEWED_FIELD, preview_qos())
        node.create_subscription(
            Header, ANNOUNCED, lambda header: self._add("announced", header, header), ANNOUNCED_DEPTH
        )

    def offer(self, message: DisplacementField) -> None:
        """Any field; it is kept until later ones have come, and must not be changed."""
        self._add("field", message.header, message)

    def _add(self, name: str, header: Header, part: Any) -> None:
        parts = self._together.add(name, stamp_to_ns(header.stamp), part)
        if parts is not None and self._output.get_subscription_count():
            self._output.publish(parts["field"])
