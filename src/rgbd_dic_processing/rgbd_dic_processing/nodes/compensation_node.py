"""compensation_node: removes the camera's motion with one method."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare, declare_path
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, make
from rgbd_dic_acquisition.nodes.spinning import run

from rgbd_dic_msgs.msg import DisplacementField as DisplacementFieldMessage
from rgbd_dic_msgs.msg import FramePair, PlaneStamped, Reference, SubsetField

from ..core.displacement import DisplacementMeasurement
from ..core.displacement_field import DisplacementField
from ..core.regions_file import load_regions
from ..core.sensor_delay import TOLD_AS
from ..core.settings import CompensationSettings
from ..core.status import FrameStatus
from .inputs import STREAM_DEPTH, CameraInput, IdleFlush, sensor_qos
from .keeping_up import KeepUp
from .messages import (
    displacement_field_message,
    frame_pair_from_message,
    plane_from_message,
    reference_from_message,
    subset_field_from_message,
)
from .preview import PreviewedFields

# Frames after which the delay between the sensors' clocks is estimated, which takes longer than an image at 60 Hz:
# first after the fewest, then after as many again as there were, at last after the most. The delay does not change.
FEWEST, MOST = 300, 1800


class CompensationNode(Node):
    def __init__(self, **options: Any) -> None:
        super().__init__("compensation_node", **options)
        self._regions = load_regions(declare_path(self, "regions_file", "regions.yaml: the fixed region"))
        self._settings = declare(self, CompensationSettings, "compensation")
        self.diagnostics = Diagnostics(self)
        self._output = self.diagnostics.watch(
            self.create_publisher(DisplacementFieldMessage, "displacement_field", STREAM_DEPTH)
        )
        self._previewed = PreviewedFields(self)
        self._step: DisplacementMeasurement | None = None
        self._frames, self._look_at, self._delay_warning = 0, FEWEST, ""
        self._keep_up = KeepUp(self, self.diagnostics)
        self.work = self._keep_up.work
        self._camera = CameraInput(self, self.diagnostics, sensor_qos(self), self._start)
        self._idle = IdleFlush(self, self._flush, IdleFlush.AFTER_OTHERS_S)

    def _start(self, camera: Camera) -> None:
        step = DisplacementMeasurement(camera, self._regions, self._settings, never_waits=self._keep_up.leaves_out)
        self._step = step
        every, newest = self.create_subscription, self._keep_up.subscribe
        for subscribe, message_type, topic, convert, add, qos in (
            (every, Reference, "reference", reference_from_message, step.set_reference, latched_qos()),
            (newest, SubsetField, "subset_field", subset_field_from_message, step.add_field, STREAM_DEPTH),
            (every, PlaneStamped, "plane", plane_from_message, step.add_plane, STREAM_DEPTH),
            (every, FramePair, "frame_pair", frame_pair_from_message, step.add_pair, STREAM_DEPTH),
        ):
            subscribe(message_type, topic, lambda message, c=convert, a=add: self._take(a(c(message))), qos)

    def _take(self, fields: list[DisplacementField]) -> None:
        self._idle.touch()
        self._publish(fields)

    def _flush(self) -> None:
        self._publish(self._step.flush())
        self._look_at_delay()

    def _look_at_delay(self) -> None:
        delay = self._step.sensor_delay()
        self._delay_warning = delay.warning
        self.diagnostics.tell(TOLD_AS, str(delay))
        if delay.warning:
            self.diagnostics.warn(delay.warning)

    def _publish(self, fields: list[DisplacementField]) -> None:
        for field in fields:
            self._frames += 1
            if self._frames >= self._look_at:
                self._look_at += min(self._frames, MOST)
                self._look_at_delay()
            self.diagnostics.count("frames")
            if field.status != FrameStatus.OK:
                self.diagnostics.count("invalid")
            if wrong := field.reason or self._delay_warning or self._keep_up.warning:
                self.diagnostics.warn(wrong)
            else:
                self.diagnostics.ok()
            message = displacement_field_message(make, field)
            self._output.publish(message)
            self._previewed.offer(message)


def main() -> int:
    return run(CompensationNode)
