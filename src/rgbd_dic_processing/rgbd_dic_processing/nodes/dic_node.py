"""dic_node: follows the subsets of the reference image through every image."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from rclpy.node import Node
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import ImageError, MeasurementError, RgbdDicError
from rgbd_dic_acquisition.messages import image_from_message, stamp_to_ns
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare, declare_path
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, make
from rgbd_dic_acquisition.nodes.spinning import run
from rgbd_dic_acquisition.serialised_image import SerialisedImage
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from rgbd_dic_msgs.msg import Reference as ReferenceMessage
from rgbd_dic_msgs.msg import SubsetField as SubsetFieldMessage
from rgbd_dic_msgs.srv import SetRegions

from ..core.correlation import CorrelationSettings
from ..core.regions_file import entries_of_text, load_regions, regions_of
from ..core.settings import RenewalSettings, SearchSettings
from ..core.status import FrameStatus
from ..core.tracking import SubsetTracking
from .inputs import STREAM_DEPTH, CameraInput, sensor_qos
from .keeping_up import KeepUp
from .messages import reference_message, subset_field_message
from .preview import PreviewOutput, PreviewSettings


class DicNode(Node):
    def __init__(self, **options: Any) -> None:
        super().__init__("dic_node", **options)
        self._regions = load_regions(declare_path(self, "regions_file", "regions.yaml: the panel"))
        self._settings = (
            declare(self, CorrelationSettings, "correlation"),
            declare(self, SearchSettings, "search"),
            declare(self, RenewalSettings, "renewal"),
        )
        self._tracking: SubsetTracking | None = None
        self._published_reference = None
        self._keyframe_ns = 0
        self.diagnostics = Diagnostics(self)
        self._reference_output = self.diagnostics.watch(
            self.create_publisher(ReferenceMessage, "reference", latched_qos())
        )
        self._output = self.diagnostics.watch(self.create_publisher(SubsetFieldMessage, "subset_field", STREAM_DEPTH))
        self._preview = PreviewOutput(self, declare(self, PreviewSettings, "preview"))
        qos = sensor_qos(self)
        self._camera = CameraInput(self, self.diagnostics, qos, self._start, compares=True)
        for name, step, promise in (
            ("~/set_reference", SubsetTracking.set_reference, "the next good image becomes the reference"),
            ("~/renew_keyframe", SubsetTracking.renew_keyframe, "the next good image becomes the keyframe"),
        ):
            self.create_service(Trigger, name, partial(self._ask, step, promise))
        self.create_service(SetRegions, "~/set_regions", self._set_regions)
        self._keep_up = KeepUp(self, self.diagnostics)
        self.work = self._keep_up.work
        self._keep_up.subscribe(Image, "camera/image_raw", self._image, qos, raw=True)

    def _start(self, camera: Camera) -> None:
        self._tracking = SubsetTracking(camera, self._regions, *self._settings)

    def _ask(
        self,
        step: Callable[[SubsetTracking], None],
        promise: str,
        _: Trigger.Request,
        response: Trigger.Response,
    ) -> Trigger.Response:
        try:
            if self._tracking is None:
                raise MeasurementError("there is no calibration yet")
            step(self._tracking)
            response.success, response.message = True, promise
        except MeasurementError as error:
            response.message = str(error)
        return response

    def _set_regions(self, request: SetRegions.Request, response: SetRegions.Response) -> SetRegions.Response:
        try:
            if self._tracking is None:
                raise MeasurementError("there is no calibration yet")
            regions = regions_of(entries_of_text(request.regions))
            stamp_ns, image = stamp_to_ns(request.image.header.stamp), image_from_message(request.image)
            tracking = SubsetTracking(self._camera.camera, regions, *self._settings)
            self._tracking = self._tracking.replaced_by(tracking, stamp_ns, image)
            self._publish_reference(request.image.header.frame_id)
            response.success, response.message = True, "measured by the new regions, from their image on"
        except RgbdDicError as error:
            response.message = str(error)
        return response

    def _publish_reference(self, frame_id: str) -> None:
        reference = self._tracking.reference
        if reference is not None and reference is not self._published_reference:
            self._published_reference = reference
            self._reference_output.publish(reference_message(make, reference, frame_id))

    def _image(self, serialised: bytes) -> None:
        received_ns = time.time_ns()
        if self._tracking is None:
            self.diagnostics.count("without camera_info")
            self.diagnostics.warn("images come, but no calibration: no calibration_file, and no camera/camera_info yet")
            return
        try:
            message = SerialisedImage.of(serialised)
        except ImageError as error:
            self.diagnostics.count("unreadable")
            self.diagnostics.warn(str(error))
            return
        try:
            image, reason = image_from_message(message), ""
        except ImageError as error:
            image, reason = None, str(error)
        field, frame_id = self._tracking.track(message.stamp_ns, image, reason), message.frame_id
        self._publish_reference(frame_id)
        if field.keyframe_stamp_ns not in (self._keyframe_ns, field.reference_stamp_ns):
            self.diagnostics.count("renewed keyframes")
            self.get_logger().info(f"the subsets are now followed from the image at {field.keyframe_stamp_ns} ns")
        self._keyframe_ns = field.keyframe_stamp_ns
        self.diagnostics.count("images")
        if field.status != FrameStatus.OK:
            self.diagnostics.count("invalid")
        if wrong := field.reason or self._tracking.refusal or self._keep_up.warning:
            self.diagnostics.warn(wrong)
        else:
            self.diagnostics.ok()
        field = replace(field, image_received_ns=received_ns)
        self._output.publish(subset_field_message(make, field, frame_id))
        if image is not None and image.dtype == np.uint8:
            self._preview.offer(image, field, frame_id)


def main() -> int:
    return run(DicNode)
