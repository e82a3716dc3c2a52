"""crack_opening_node: the opening of the crack from each displacement field."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

from rclpy.node import Node
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import RegionsError
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare, declare_path
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, make
from rgbd_dic_acquisition.nodes.spinning import run

from rgbd_dic_msgs.msg import CrackOpening, DisplacementField, Reference
from rgbd_dic_msgs.srv import OpeningHistory

from ..core.crack import CrackMeasurement
from ..core.displacement_field import DisplacementField as CoreField
from ..core.opening_log import OpeningLog
from ..core.regions_file import load_regions
from ..core.settings import CrackSettings
from .inputs import STREAM_DEPTH, CameraInput, OfReference, sensor_qos
from .keeping_up import KeepUp
from .messages import (
    crack_opening_message,
    displacement_field_from_message,
    reference_from_message,
    write_opening_history,
)


class CrackOpeningNode(Node):
    def __init__(self, **options: Any) -> None:
        super().__init__("crack_opening_node", **options)
        path = declare_path(self, "regions_file", "regions.yaml: the zones on the two sides of the crack")
        regions = load_regions(path)
        if regions.crack is None:
            raise RegionsError(f"{path}: has no entry 'crack': draw the measuring zones (see docs/files.md)")
        self._zones = regions.crack
        self._of_reference = OfReference(self._measure)
        self._settings = declare(self, CrackSettings, "crack")
        self.diagnostics = Diagnostics(self)
        self._output = self.diagnostics.watch(self.create_publisher(CrackOpening, "crack_opening", STREAM_DEPTH))
        self._log = OpeningLog()
        self.create_service(
            OpeningHistory, "~/history", lambda _, answer: write_opening_history(answer, self._log.kept())
        )
        self._keep_up = KeepUp(self, self.diagnostics)
        self.work = self._keep_up.work
        self._camera = CameraInput(self, self.diagnostics, sensor_qos(self), self._start)

    def _start(self, camera: Camera) -> None:
        self._crack = CrackMeasurement(camera, self._zones, self._settings)
        self.create_subscription(Reference, "reference", partial(self._reference, camera), latched_qos())
        self._keep_up.subscribe(
            DisplacementField,
            "displacement_field",
            lambda message: self._of_reference.add(displacement_field_from_message(message)),
            STREAM_DEPTH,
        )

    def _reference(self, camera: Camera, message: Reference) -> None:
        reference = reference_from_message(message)
        zones = (reference.regions.crack if reference.regions else None) or self._zones
        self._crack = CrackMeasurement(camera, zones, self._settings)
        self._of_reference.know(reference.stamp_ns, self._crack)

    def _measure(self, field: CoreField, crack: CrackMeasurement | None) -> None:
        opening = (crack or self._crack).measure(field)
        self._log.add(opening.stamp_ns, opening.opening_m, opening.u_opening_m)
        self.diagnostics.count("frames")
        if not opening.valid:
            self.diagnostics.count("invalid")
        if wrong := opening.reason or self._keep_up.warning:
            self.diagnostics.warn(wrong)
        else:
            self.diagnostics.ok()
        latency_s = (time.time_ns() - field.image_received_ns) * 1e-9
        self._output.publish(crack_opening_message(make, replace(opening, latency_s=latency_s)))


def main() -> int:
    return run(CrackOpeningNode)
