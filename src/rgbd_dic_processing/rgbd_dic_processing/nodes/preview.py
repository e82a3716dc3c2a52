"""Small pictures of what dic_node measures, for the live page and for viewers."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rgbd_dic_acquisition.messages import header_message, image_message
from rgbd_dic_acquisition.nodes.ros_messages import make
from rgbd_dic_acquisition.settings import Settings, setting

from rgbd_dic_msgs.msg import FrameStatus, Preview

from ..core.subset_field import SubsetField
from ..core.view import made_small

TOPIC = "_preview"  # hidden: no recorder takes it for a part of the measurement


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

    def offer(self, image: NDArray[np.uint8], field: SubsetField, frame_id: str) -> None:
        """An image (rows, cols), mono8, and where the subsets are in it."""
        now = time.monotonic()
        if now < self._due_s or not self._output.get_subscription_count():
            return
        self._due_s = now + 1 / self._settings.rate_hz
        height, width = image.shape
        small = made_small(image, self._settings.width_px)
        self._output.publish(
            Preview(
                header=header_message(make, field.stamp_ns, frame_id),
                width=width,
                height=height,
                small=image_message(make, field.stamp_ns, frame_id, small, "mono8"),
                status=FrameStatus(value=int(field.status)),
                reason=field.reason,
                homography=field.homography.ravel(),
            )
        )
