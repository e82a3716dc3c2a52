"""The ToF sensor: depth, intensity and confidence with its calibration."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, TimeReference

from ..calibration import Calibration, intrinsics_of, load_calibration, points_from_depth
from ..drivers.tof_camera import TofCamera
from ..drivers.tof_device import LIBRARIES
from ..drivers.tof_settings import TofSettings
from ..errors import RgbdDicError
from ..messages import (
    TF,
    camera_info_message,
    depth_message,
    header_message,
    image_message,
    points_message,
    stamp_message,
    transform_message,
)
from ..revival import Revival
from ..settings import setting
from ..simulator.flight import FlightSettings
from ..simulator.live import SimulatedTof
from ..sources import DepthFrame
from .diagnostics import Diagnostics, WatchedPublisher
from .parameters import declare, declare_path
from .ros_messages import QosSettings, detail_qos, image_qos, latched_qos, make, message_class
from .sensor_reading import SensorHealth, read_sensor
from .spinning import run

TIME_REFERENCE = "sensor_msgs/msg/TimeReference"


@dataclass(frozen=True)
class TofNodeSettings(QosSettings):
    """Where the depth frames come from and how they are sent."""

    source: str = setting(
        "simulated",
        doc="where the depth frames come from: a simulated flight, a camera through a GenTL producer, or through pylon",
        choices=("simulated", *LIBRARIES),
    )
    frame_id: str = setting("tof_optical_frame", doc="frame of the depth: z forward, x right, y down")
    camera_frame_id: str = setting("camera_optical_frame", doc="the greyscale camera's, parent in /tf_static")
    publish_points: bool = setting(False, doc="whether tof/points is published too")


class TofNode(Node):
    """Publishes `tof/depth/image_raw` (16UC1, mm, 0 invalid), its camera_info, intensity and confidence.

    Optionally `tof/points`, one point a pixel [m], NaN where there is none. If the sensor has a clock of its own,
    also `tof/time_reference`: host time of the stamp, and the sensor's.
    """

    def __init__(self) -> None:
        super().__init__("tof_node")
        self._settings = declare(self, TofNodeSettings)
        flight = declare(self, FlightSettings, "flight")
        device = declare(self, TofSettings, "tof")
        path = declare_path(self, "calibration", "calibration.yaml in place of the source's own", False)
        calibration = load_calibration(path) if path else None
        if self._settings.source == "simulated":
            self._source = SimulatedTof(flight)
            calibration = calibration or self._source.flight.calibration
        else:
            self._source = TofCamera(self._settings.source, device)
        self._calibrated = calibration.tof if calibration is not None else None
        self._revival = Revival(self._source)
        self._diagnostics = Diagnostics(self)
        self._health = SensorHealth(self._diagnostics, self._revival, self._source, self._loss)
        self._depth = self._publisher(Image, "tof/depth/image_raw")
        self._info = self._publisher(CameraInfo, "tof/depth/camera_info")
        self._intensity = self._publisher(Image, "tof/intensity/image_raw")
        self._confidence = self._publisher(Image, "tof/confidence/image_raw")
        self._points = self._publisher(PointCloud2, "tof/points") if self._settings.publish_points else None
        self._time = self._publisher(TimeReference, "tof/time_reference")
        if calibration is not None:
            self._publish_transform(calibration)
        else:
            self.get_logger().warning("no calibration.yaml: no extrinsics on /tf_static")

    def work(self) -> Iterator[float]:
        """Publish frame after frame."""
        return read_sensor(self._revival, self._health, self._publish, self._say_what_runs)

    def close(self) -> None:
        self._revival.close()

    def _publish(self, frame: DepthFrame) -> None:
        about = (frame.stamp_ns, self._settings.frame_id)
        camera = intrinsics_of(frame.depth_m.shape, self._calibrated or self._source.camera)
        self._depth.publish(depth_message(make, *about, frame.depth_m))
        self._info.publish(camera_info_message(make, *about, camera))
        if self._points is not None:
            points = frame.points_m
            points = points_from_depth(camera, frame.depth_m) if points is None else points.reshape(-1, 3)
            self._points.publish(points_message(make, *about, points))
        for publisher, array in ((self._intensity, frame.intensity), (self._confidence, frame.confidence)):
            if array is not None:
                publisher.publish(image_message(make, *about, array, "mono16"))
        if frame.device_ns is not None:
            header, device = header_message(make, frame.stamp_ns, ""), stamp_message(make, frame.device_ns)
            self._time.publish(make(TIME_REFERENCE, header=header, time_ref=device, source="tof"))

    def _loss(self, new: Counter[str]) -> str:
        if new["failed"]:
            return f"buffers of the ToF camera fail: {self._source.failure}"
        return "frames of the ToF camera are lost on the way: see docs/payload.md, ToF camera" if new["lost"] else ""

    def _say_what_runs(self) -> None:
        told = ", ".join(f"{name}: {value}" for name, value in self._source.told.items())
        own = self._source.camera
        self.get_logger().info(f"{self._settings.source} ToF camera runs: {self._calibrated or own}; {told}")
        if self._calibrated and own and not self._calibrated.agrees_with(own):
            self.get_logger().warning(f"calibration.yaml is used, {self._calibrated}; the ToF camera says {own}")

    def _publisher(self, kind: type, topic: str) -> WatchedPublisher:
        large = kind in (Image, PointCloud2)
        qos = image_qos(self._settings) if large else detail_qos(self._settings)
        return self._diagnostics.watch(self.create_publisher(kind, topic, qos))

    def _publish_transform(self, calibration: Calibration) -> None:
        try:
            tf = message_class(TF)
        except RgbdDicError as error:
            self.get_logger().warning(f"no /tf_static: {error}. The extrinsics are in calibration.yaml")
            return
        frames = (self._settings.camera_frame_id, self._settings.frame_id)
        publisher = self._diagnostics.watch(self.create_publisher(tf, "/tf_static", latched_qos()))
        publisher.publish(transform_message(make, time.time_ns(), calibration, *frames))


def main(args: Sequence[str] | None = None) -> int:
    return run(TofNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
