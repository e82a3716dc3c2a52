"""The pictures of the live page: a few images a second, with the regions where the motion has carried them."""

from __future__ import annotations

import numpy as np
from rclpy.node import Node
from rclpy.subscription import Subscription
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.messages import image_from_message, stamp_to_ns

from rgbd_dic_msgs.msg import Preview

from ..core.carried_regions import carried_regions
from ..core.regions import Regions
from ..pages.live_state import LiveState, Picture
from .preview import TOPIC, preview_qos


class LivePictures:
    """Listens to the previews while pictures are wanted.

    Attributes:
        regions, camera: what the outlines follow from; None until they are known.
    """

    def __init__(self, node: Node, state: LiveState, quality: int):
        self._node, self._state, self._quality = node, state, quality
        self._previews: Subscription | None = None
        self._number = 0
        self.regions: Regions | None = None
        self.camera: Camera | None = None

    def turn(self, watched: bool) -> None:
        """Called often: listen or not, by whether anybody looks."""
        wanted = watched and self._state.picture_wanted()
        if wanted and self._previews is None:
            self._previews = self._node.create_subscription(Preview, TOPIC, self._preview, preview_qos())
        elif not wanted and self._previews is not None:
            self._node.destroy_subscription(self._previews)
            self._previews = None

    def _preview(self, message: Preview) -> None:
        outlines, homography = {}, np.array(message.homography, float).reshape(3, 3)
        if self.regions is not None and self.camera is not None:
            carried = carried_regions(self.regions, self.camera, homography)
            outlines = {name: [np.round(p, 1).tolist() for p in polygons] for name, polygons in carried.items()}
        self._number += 1
        about = (self._number, stamp_to_ns(message.header.stamp), message.width, message.height)
        self._state.set_picture(
            Picture(*about, image_from_message(message.small), self._quality, outlines, message.reason)
        )
