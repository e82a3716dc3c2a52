"""plane_node: the panel's plane in the camera frame, from each ToF frame."""

from __future__ import annotations

import contextlib
from typing import Any

from rclpy.node import Node
from rgbd_dic_acquisition.calibration import load_calibration
from rgbd_dic_acquisition.errors import ImageError
from rgbd_dic_acquisition.messages import depth_from_message, points_from_message, stamp_to_ns
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare, declare_path
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, make
from rgbd_dic_acquisition.nodes.spinning import run
from rgbd_dic_acquisition.serialised_image import SerialisedImage
from sensor_msgs.msg import Image, PointCloud2

from rgbd_dic_msgs.msg import PlaneStamped
from rgbd_dic_msgs.msg import Reference as ReferenceMessage
from rgbd_dic_msgs.msg import SubsetField as SubsetFieldMessage

from ..core.plane import PanelPlane, PlaneEstimate
from ..core.regions import Regions
from ..core.regions_file import load_regions
from ..core.settings import PairingSettings, PlaneSettings
from ..core.subset_field import SubsetField
from .inputs import STREAM_DEPTH, IdleFlush, OfReference, sensor_qos
from .keeping_up import KeepUp
from .messages import plane_message, reference_from_message, subset_field_from_message


class PlaneNode(Node):
    def __init__(self, **options: Any) -> None:
        super().__init__("plane_node", **options)
        calibration = load_calibration(
            declare_path(self, "calibration_file", "calibration.yaml: intrinsics of both sensors, extrinsics")
        )
        regions = load_regions(declare_path(self, "regions_file", "regions.yaml: the panel and the crack"))
        pairing = declare(self, PairingSettings, "pairing")
        self._planes = PanelPlane(calibration, regions, declare(self, PlaneSettings, "plane"), pairing.tof_delay_ns)
        self._of_reference, self._regions = OfReference(self._view), regions
        self._frame_id = "camera_optical_frame"
        self.diagnostics = Diagnostics(self)
        self._output = self.diagnostics.watch(self.create_publisher(PlaneStamped, "plane", STREAM_DEPTH))
        self._idle = IdleFlush(self, lambda: self._publish(self._planes.flush()))
        qos = sensor_qos(self)
        self._keep_up = KeepUp(self, self.diagnostics)
        self.work = self._keep_up.work
        if self.declare_parameter("use_points", False).value:
            self._keep_up.subscribe(
                PointCloud2,
                "tof/points",
                self._points,
                qos,
                lambda cloud: self._left_out(stamp_to_ns(cloud.header.stamp)),
            )
        else:
            self._keep_up.subscribe(
                Image,
                "tof/depth/image_raw",
                self._depth,
                qos,
                self._left_out_depth,
                raw=True,
            )
        self.create_subscription(ReferenceMessage, "reference", self._reference, latched_qos())
        self.create_subscription(SubsetFieldMessage, "subset_field", self._subset_field, STREAM_DEPTH)

    def _depth(self, serialised: bytes) -> None:
        self._idle.touch()
        try:
            message = SerialisedImage.of(serialised)
        except ImageError as error:
            self.diagnostics.count("unreadable")
            self.diagnostics.warn(str(error))
            return
        try:
            depth, reason = depth_from_message(message), ""
        except ImageError as error:
            depth, reason = None, str(error)
        self._publish(self._planes.add_depth(message.stamp_ns, depth, reason))

    def _points(self, message: PointCloud2) -> None:
        self._idle.touch()
        try:
            points, reason = points_from_message(message), ""
        except ImageError as error:
            points, reason = None, str(error)
        self._publish(self._planes.add_points(stamp_to_ns(message.header.stamp), points, reason))

    def _left_out_depth(self, serialised: bytes) -> None:
        with contextlib.suppress(ImageError):
            self._left_out(SerialisedImage.of(serialised).stamp_ns)

    def _left_out(self, stamp_ns: int) -> None:
        self._publish(self._planes.add_points(stamp_ns, None, self._keep_up.warning))

    def _subset_field(self, message: SubsetFieldMessage) -> None:
        self._idle.touch()
        self._frame_id = message.header.frame_id
        self._of_reference.add(subset_field_from_message(message))

    def _reference(self, message: ReferenceMessage) -> None:
        reference = reference_from_message(message)
        self._of_reference.know(reference.stamp_ns, reference.regions)

    def _view(self, field: SubsetField, regions: Regions | None) -> None:
        if regions is not None and regions.entries != self._regions.entries:
            self._regions = regions
            self._planes.take_regions(regions)
        self._publish(self._planes.add_view(field.stamp_ns, field.view))

    def _publish(self, estimates: list[PlaneEstimate]) -> None:
        for estimate in estimates:
            self.diagnostics.count("planes" if estimate.plane is not None else "invalid")
            if estimate.plane is None:
                self.diagnostics.warn(f"no plane: {estimate.reason}")
            else:
                self.diagnostics.ok()
            self._output.publish(plane_message(make, estimate, self._frame_id))


def main() -> int:
    return run(PlaneNode)
