"""viewer_node: pictures, markers and clouds for Foxglove and rviz; it hears the graph only while somebody looks."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rgbd_dic_acquisition.calibration import load_calibration, pixel_rays
from rgbd_dic_acquisition.errors import ImageError
from rgbd_dic_acquisition.in_flight import header_stamp_ns
from rgbd_dic_acquisition.messages import depth_from_message, image_from_message, points_from_message, stamp_to_ns
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare, declare_path
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, make, message_class
from rgbd_dic_acquisition.nodes.spinning import run
from sensor_msgs.msg import Image, PointCloud2

from rgbd_dic_msgs.msg import CrackOpening, DisplacementField, PlaneStamped, Preview, Reference

from ..core.crack import CrackOpening as Opening
from ..core.plane import PlaneEstimate, cloud_of_depth
from ..core.regions import Regions
from ..core.view import ColourScale, Viewing, nearest_plane
from ..view_topics import VIEW_TYPES
from .messages import (
    crack_opening_from_message,
    displacement_field_from_message,
    plane_from_message,
    reference_from_message,
)
from .preview import TOPIC, preview_qos
from .same_stamp import SameStamp
from .view_messages import ViewerSettings, band_message, cloud_message, view_messages
from .while_wanted import WhileWanted

LOOK_S = 0.2  # how often it looks whether somebody looks
NICENESS = 10  # the measurement goes first
CLOUD = "view/cloud"


class ViewerNode(Node):
    def __init__(self) -> None:
        super().__init__("viewer_node")
        self._settings = declare(self, ViewerSettings, "viewer")
        path = declare_path(self, "calibration_file", "calibration.yaml: intrinsics of both sensors, extrinsics")
        self._calibration = load_calibration(path)
        self._viewing, self._scale = Viewing(self._calibration.camera), ColourScale()
        self._rays = pixel_rays(self._calibration.tof) if self._calibration.tof is not None else None
        self._together = SameStamp("preview", "field", "opening")
        self._regions: dict[int, Regions | None] = {}
        self._planes: deque[PlaneEstimate] = deque(maxlen=64)
        self._depth: bytes | None = None
        self._diagnostics = Diagnostics(self)
        self._outputs = {
            topic: self._diagnostics.watch(self.create_publisher(message_class(kind), topic, 4))
            for topic, kind in VIEW_TYPES.items()
        }
        points = self.declare_parameter("use_points", False).value
        depth = (PointCloud2, "tof/points") if points else (Image, "tof/depth/image_raw")
        self._depth_type = depth[0]
        self._images = WhileWanted(
            self,
            (Reference, "reference", self._reference, latched_qos()),
            (Preview, TOPIC, self._preview, preview_qos()),
            (PlaneStamped, "plane", lambda message: self._planes.append(plane_from_message(message)), _newest(20)),
            (DisplacementField, "displacement_field", self._field, _newest(20), True),
            (CrackOpening, "crack_opening", self._opening, _newest(100)),
        )
        self._depths = WhileWanted(self, (*depth, self._take_depth, _newest(1), True))
        self.create_timer(LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _look(self) -> None:
        self._images.follow(any(output.matched for output in self._outputs.values()))
        self._depths.follow(self._outputs[CLOUD].matched > 0)

    def _reference(self, message: Reference) -> None:
        reference = reference_from_message(message)
        self._regions = {**dict(list(self._regions.items())[-8:]), reference.stamp_ns: reference.regions}

    def _preview(self, message: Preview) -> None:
        self._add("preview", stamp_to_ns(message.header.stamp), message)

    def _field(self, data: bytes) -> None:
        self._add("field", header_stamp_ns(data), data)

    def _opening(self, message: CrackOpening) -> None:
        opening = crack_opening_from_message(message)
        self._publish("view/opening", lambda: band_message(make, opening, message.header.frame_id))
        self._add("opening", opening.stamp_ns, opening)

    def _take_depth(self, data: bytes) -> None:
        self._depth = data

    def _add(self, name: str, stamp_ns: int, part: Any) -> None:
        parts = self._together.add(name, stamp_ns, part)
        if parts is not None:
            self._show(stamp_ns, parts["preview"], parts["field"], parts["opening"])

    def _show(self, stamp_ns: int, preview: Preview, data: bytes, opening: Opening) -> None:
        field = displacement_field_from_message(deserialize_message(data, DisplacementField))
        homography = np.array(preview.homography, float).reshape(3, 3)
        small, plane = image_from_message(preview.small), nearest_plane(self._planes, stamp_ns)
        view = self._viewing.view(small, homography, self._regions.get(field.reference_stamp_ns), field, plane)
        self._scale.widen(field.reference_stamp_ns, view.displacement_m[:, 0])
        about = (make, stamp_ns, preview.header.frame_id)
        for topic, content in view_messages(*about, view, self._scale, opening, self._settings).items():
            self._publish(topic, content)
        if self._depth is not None:
            self._publish(CLOUD, lambda: self._cloud(preview.header.frame_id))

    def _publish(self, topic: str, content: Callable[[], Any]) -> None:
        if self._outputs[topic].matched:
            message = content()
            if message is not None:
                self._outputs[topic].publish(message)

    def _cloud(self, frame_id: str) -> PointCloud2 | None:
        message, self._depth = deserialize_message(self._depth, self._depth_type), None
        try:
            if self._depth_type is PointCloud2:
                points = points_from_message(message)
            else:
                points = cloud_of_depth(depth_from_message(message), self._calibration.tof, self._rays)
        except ImageError as error:
            self._diagnostics.warn(str(error))
            return None
        stamp_ns = stamp_to_ns(message.header.stamp)
        points = points @ self._calibration.R_camera_tof.T + self._calibration.t_camera_tof
        plane = nearest_plane(self._planes, stamp_ns)
        return cloud_message(make, stamp_ns, frame_id, points, plane, self._settings.most_points)


def _newest(depth: int) -> QoSProfile:
    """Best effort: whoever publishes never waits for a viewer."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def main(args: Sequence[str] | None = None) -> int:
    os.nice(NICENESS)
    return run(ViewerNode, args)
