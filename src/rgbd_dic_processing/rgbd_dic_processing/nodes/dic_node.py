"""dic_node: follows the subsets of the reference image through every image."""

from __future__ import annotations

import time
from dataclasses import replace

from rclpy.node import Node
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import ImageError, MeasurementError
from rgbd_dic_acquisition.messages import image_from_message, stamp_to_ns
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare, declare_path
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, make
from rgbd_dic_acquisition.nodes.spinning import run
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from rgbd_dic_msgs.msg import Reference as ReferenceMessage
from rgbd_dic_msgs.msg import SubsetField as SubsetFieldMessage

from ..core.correlation import CorrelationSettings
from ..core.regions import load_regions
from ..core.settings import SearchSettings
from ..core.status import FrameStatus
from ..core.tracking import SubsetTracking
from .inputs import STREAM_DEPTH, CameraInput, sensor_qos
from .messages import reference_message, subset_field_message


class DicNode(Node):
    def __init__(self) -> None:
        super().__init__("dic_node")
        self._regions = load_regions(declare_path(self, "regions_file", "regions.yaml: the panel"))
        self._settings = (
            declare(self, CorrelationSettings, "correlation"),
            declare(self, SearchSettings, "search"),
        )
        self._tracking: SubsetTracking | None = None
        self._published_reference = None
        self._diagnostics = Diagnostics(self)
        self._reference_output = self._diagnostics.watch(
            self.create_publisher(ReferenceMessage, "reference", latched_qos())
        )
        self._output = self._diagnostics.watch(self.create_publisher(SubsetFieldMessage, "subset_field", STREAM_DEPTH))
        qos = sensor_qos(self)
        self._camera = CameraInput(self, self._diagnostics, qos, self._start)
        self.create_service(Trigger, "~/set_reference", self._set_reference)
        self.create_subscription(Image, "camera/image_raw", self._image, qos)

    def _start(self, camera: Camera) -> None:
        self._tracking = SubsetTracking(camera, self._regions, *self._settings)

    def _set_reference(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            if self._tracking is None:
                raise MeasurementError("there is no calibration yet")
            self._tracking.renew_reference()
            response.success, response.message = True, "the next good image becomes the reference"
        except MeasurementError as error:
            response.message = str(error)
        return response

    def _image(self, message: Image) -> None:
        received_ns = time.time_ns()
        if self._tracking is None:
            self._diagnostics.count("without camera_info")
            self._diagnostics.warn(
                "images come, but no calibration: no calibration_file, and no camera/camera_info yet"
            )
            return
        try:
            image, reason = image_from_message(message), ""
        except ImageError as error:
            image, reason = None, str(error)
        field = self._tracking.track(stamp_to_ns(message.header.stamp), image, reason)
        frame_id = message.header.frame_id
        reference = self._tracking.reference
        if reference is not None and reference is not self._published_reference:
            self._published_reference = reference
            self._reference_output.publish(reference_message(make, reference, frame_id))
        self._diagnostics.count("images")
        if field.status == FrameStatus.OK:
            self._diagnostics.ok()
        else:
            self._diagnostics.count("invalid")
            self._diagnostics.warn(field.reason)
        field = replace(field, image_received_ns=received_ns)
        self._output.publish(subset_field_message(make, field, frame_id))


def main() -> int:
    return run(DicNode)
