"""Fetches an image of the running graph to draw regions on."""

from __future__ import annotations

import contextlib
import time
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import CalibrationError, MeasurementError
from rgbd_dic_acquisition.messages import image_from_message, stamp_to_ns
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos
from sensor_msgs.msg import CameraInfo, Image

from rgbd_dic_msgs.msg import PlaneStamped, Reference, SubsetField

from ..core.carried_regions import carried_entries
from ..core.geometry import Plane
from ..core.settings import ProcessingSettings
from ..core.view import nearest_plane
from ..pages.drawing import Drawing
from .inputs import STREAM_DEPTH
from .messages import plane_from_message, reference_from_message

Array = NDArray[np.float64]
FIELD_TIMEOUT_S = 4.0  # in which a graph that measures is heard
IMAGE_TIMEOUT_S = 10.0
REST_TIMEOUT_S = 5.0  # for what belongs to the image, from when it came


class DrawingFetch:
    """Listens until an image has come, with its calibration, a plane near it, and the regions carried into it.

    The image is asked for once a field has come: only then is it sure that its own will be heard.
    """

    def __init__(self, node: Node, camera: Camera | None):
        self._node, self._camera, self._begun_s = node, camera, time.monotonic()
        self._image: Image | None = None
        self._image_s: float | None = None  # when it came
        self._reference: Reference | None = None
        self._planes: list[PlaneStamped] = []
        self._views: dict[int, Array] = {}
        self._image_subscription: Subscription | None = None
        self._heard = [
            node.create_subscription(*stream)
            for stream in (
                (CameraInfo, "camera/camera_info", self._take_info, _latest()),
                (PlaneStamped, "plane", self._planes.append, _latest()),
                (SubsetField, "subset_field", self._take_field, STREAM_DEPTH),
                (Reference, "reference", partial(setattr, self, "_reference"), latched_qos()),
            )
        ]

    def result(self, settings: ProcessingSettings, noise: float) -> tuple[Drawing, dict[str, Any]] | None:
        """The drawing, and the entries of the regions in force, carried into its image; none if not found in it.

        Returns:
            None as long as something may still come.

        Raises:
            RgbdDicError: if no image came in time, or it cannot be drawn on.
        """
        now_s = time.monotonic()
        if self._image_subscription is None and (self._views or now_s - self._begun_s > FIELD_TIMEOUT_S):
            self._listen_to_images()
        if self._image is None:
            if now_s - self._begun_s < FIELD_TIMEOUT_S + IMAGE_TIMEOUT_S:
                return None
            raise MeasurementError(f"no image came within {IMAGE_TIMEOUT_S:g} s: is the camera running?")
        stamp_ns = stamp_to_ns(self._image.header.stamp)
        plane, view = self._plane(), self._views.get(stamp_ns)
        rest = (plane, view, self._camera, self._reference)
        if now_s - self._image_s < REST_TIMEOUT_S and any(part is None for part in rest):
            return None
        drawing = Drawing(
            f"live image of {stamp_ns * 1e-9:.3f} s",
            stamp_ns,
            image_from_message(self._image),
            settings,
            noise,
            self._camera,
            plane=plane if self._camera is not None else None,
            no_depth="no plane of the panel came near the image",
            frame_id=self._image.header.frame_id,
        )
        if view is None or self._camera is None or self._reference is None or not np.isfinite(view).all():
            return drawing, {}
        regions = reference_from_message(self._reference).regions
        return drawing, carried_entries(regions.entries, self._camera, view) if regions is not None else {}

    def close(self) -> None:
        for subscription in self._heard:
            self._node.destroy_subscription(subscription)

    def _listen_to_images(self) -> None:
        self._image_subscription = self._node.create_subscription(
            Image, "camera/image_raw", self._take_image, _latest()
        )
        self._heard.append(self._image_subscription)

    def _take_image(self, message: Image) -> None:
        if self._image is None:
            self._image, self._image_s = message, time.monotonic()

    def _take_field(self, message: SubsetField) -> None:
        self._views[stamp_to_ns(message.header.stamp)] = np.array(message.homography, float).reshape(3, 3)

    def _take_info(self, message: CameraInfo) -> None:
        with contextlib.suppress(CalibrationError):  # an image without calibration can be drawn on too
            self._camera = self._camera or Camera.from_camera_info(message)

    def _plane(self) -> Plane | None:
        """The one nearest in time to the image, if it is near enough."""
        return nearest_plane(map(plane_from_message, self._planes), stamp_to_ns(self._image.header.stamp))


def _latest() -> QoSProfile:
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
