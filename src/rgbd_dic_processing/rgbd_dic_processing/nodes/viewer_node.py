"""viewer_node: pictures, markers and clouds for Foxglove and rviz; it hears the graph only while somebody looks."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rgbd_dic_acquisition.calibration import load_calibration
from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_acquisition.in_flight import header_stamp_ns
from rgbd_dic_acquisition.messages import depth_from_message, image_from_message, points_from_message, stamp_to_ns
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare, declare_path
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, make, message_class
from rgbd_dic_acquisition.nodes.spinning import run
from sensor_msgs.msg import Image, PointCloud2

from rgbd_dic_msgs.msg import CrackOpening, DisplacementField, PlaneStamped, Preview, Reference

from ..view_topics import PREVIEWED_FIELD, VIEW_TYPES
from .attended import Attended
from .messages import (
    crack_opening_from_message,
    displacement_field_from_message,
    plane_from_message,
    reference_from_message,
)
from .preview import TOPIC, preview_qos
from .same_stamp import SameStamp
from .shelf import Shelf
from .view_messages import ViewerSettings, band_message
from .viewer import Viewer
from .while_wanted import WhileWanted

LOOK_S = 0.2  # how often it looks whether somebody looks
NICENESS = 10  # the measurement goes first
CLOUD, BAND = "view/cloud", "view/opening"
OPENINGS_DEPTH = 300  # openings that may come between two looks
FIELDS_EARLY, OPENINGS_EARLY = 8, 300  # that may come before their preview


class ViewerNode(Node):
    def __init__(self) -> None:
        super().__init__("viewer_node")
        settings = declare(self, ViewerSettings, "viewer")
        path = declare_path(self, "calibration_file", "calibration.yaml: intrinsics of both sensors, extrinsics")
        self._viewer = Viewer(make, load_calibration(path), settings)
        self._together = SameStamp("preview", {"field": FIELDS_EARLY, "opening": OPENINGS_EARLY})
        self._depth: bytes | None = None
        self._diagnostics = Diagnostics(self)
        self._outputs = {
            topic: self._diagnostics.watch(self.create_publisher(message_class(kind), topic, 4))
            for topic, kind in VIEW_TYPES.items()
        }
        points = self.declare_parameter("use_points", False).value
        depth = (PointCloud2, "tof/points") if points else (Image, "tof/depth/image_raw")
        self._depth_type = depth[0]
        self._attended = {topic: Attended(output) for topic, output in self._outputs.items() if topic != BAND}
        self._images = WhileWanted(
            self,
            (Reference, "reference", lambda m: self._viewer.know_reference(reference_from_message(m)), latched_qos()),
            (Preview, TOPIC, self._preview, preview_qos()),
            (PlaneStamped, "plane", lambda m: self._viewer.know_plane(plane_from_message(m)), _newest(20)),
            (DisplacementField, PREVIEWED_FIELD, self._field, preview_qos(), True),
        )
        self._openings = Shelf(self, CrackOpening, "crack_opening", OPENINGS_DEPTH)
        self._depths = WhileWanted(self, (*depth, self._take_depth, _newest(1), True))
        self.create_timer(LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _look(self) -> None:
        attended = {topic: attended.now() for topic, attended in self._attended.items()}
        shown = any(attended.values())
        self._images.follow(shown)
        self._openings.listen() if shown or self._outputs[BAND].matched else self._openings.rest()
        for opening in self._openings.taken():
            self._opening(opening)
        self._depths.follow(attended[CLOUD])

    def close(self) -> None:
        self._openings.close()

    def _preview(self, message: Preview) -> None:
        self._add("preview", stamp_to_ns(message.header.stamp), message)

    def _field(self, data: bytes) -> None:
        self._add("field", header_stamp_ns(data), data)

    def _opening(self, message: CrackOpening) -> None:
        opening = crack_opening_from_message(message)
        self._publish(BAND, lambda: band_message(make, opening, message.header.frame_id))
        self._add("opening", opening.stamp_ns, opening)

    def _take_depth(self, data: bytes) -> None:
        self._depth = data

    def _add(self, name: str, stamp_ns: int, part: Any) -> None:
        parts = self._together.add(name, stamp_ns, part)
        if parts is not None:
            self._show(**parts)

    def _show(self, preview: Preview, field: bytes, opening: Any) -> None:
        read = displacement_field_from_message(deserialize_message(field, DisplacementField))
        homography, frame_id = np.array(preview.homography, float).reshape(3, 3), preview.header.frame_id
        small = image_from_message(preview.small)
        self._diagnostics.count("pictures")
        for topic, content in self._viewer.messages(frame_id, small, homography, read, opening).items():
            self._publish(topic, content)
        if self._depth is not None:
            self._publish(CLOUD, lambda: self._cloud(frame_id))

    def _publish(self, topic: str, content: Callable[[], Any]) -> None:
        if self._outputs[topic].matched and (message := content()) is not None:
            self._outputs[topic].publish(message)

    def _cloud(self, frame_id: str) -> PointCloud2 | None:
        message, self._depth = deserialize_message(self._depth, self._depth_type), None
        stamp_ns = stamp_to_ns(message.header.stamp)
        try:
            if self._depth_type is PointCloud2:
                cloud = self._viewer.cloud(stamp_ns, frame_id, points_from_message(message))
            else:
                cloud = self._viewer.cloud_of_depth(stamp_ns, frame_id, depth_from_message(message))
            self._diagnostics.ok()
        except RgbdDicError as error:
            cloud = None
            self._diagnostics.warn(str(error))
        return cloud


def _newest(depth: int) -> QoSProfile:
    """Best effort: whoever publishes never waits for a viewer."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def main(args: Sequence[str] | None = None) -> int:
    os.nice(NICENESS)
    return run(ViewerNode, args)
