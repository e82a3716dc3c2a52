"""The ToF sensor: depth, intensity and confidence with its calibration."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from ..calibration import Calibration, Camera, load_calibration, points_from_depth
from ..drivers.live_tof import LiveTof
from ..drivers.tof_device import LIBRARIES
from ..drivers.tof_features import TofSettings
from ..errors import CalibrationError, RgbdDicError
from ..messages import TF, camera_info_message, depth_message, image_message, points_message, transform_message
from ..settings import setting
from ..simulator.flight import FlightSettings
from ..simulator.live import SimulatedTof
from ..sources import DepthFrame
from .diagnostics import Diagnostics, WatchedPublisher
from .parameters import declare, declare_path
from .ros_messages import QosSettings, image_qos, latched_qos, make, message_class
from .spinning import run

READ_S = 0.02


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

    Optionally `tof/points`, one point a pixel [m], NaN where there is none.
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
            self._source = LiveTof(self._settings.source, device)
        if calibration is not None and calibration.tof is None and self._settings.source == "simulated":
            raise CalibrationError(f"{path} has no entry 'tof': the depth frames would be uncalibrated")
        self._calibrated = calibration.tof if calibration is not None else None
        self._counted: Counter[str] = Counter()
        self._diagnostics = Diagnostics(self)
        self._depth = self._publisher(Image, "tof/depth/image_raw")
        self._info = self._publisher(CameraInfo, "tof/depth/camera_info")
        self._intensity = self._publisher(Image, "tof/intensity/image_raw")
        self._confidence = self._publisher(Image, "tof/confidence/image_raw")
        self._points = self._publisher(PointCloud2, "tof/points") if self._settings.publish_points else None
        if calibration is not None:
            self._publish_transform(calibration)

    def work(self) -> Iterator[float]:
        """Publish frame after frame."""
        self._source.open()
        self.get_logger().info(f"{self._settings.source} ToF sensor: {self._calibrated or 'intrinsics of the device'}")
        while True:
            frame = self._source.read(READ_S)
            if frame is not None:
                self._publish(frame)
            self._report()
            yield 0.0

    def close(self) -> None:
        self._source.close()

    def _publish(self, frame: DepthFrame) -> None:
        about = (frame.stamp_ns, self._settings.frame_id)
        camera = self._camera(frame)
        self._depth.publish(depth_message(make, *about, frame.depth_m))
        self._info.publish(camera_info_message(make, *about, camera))
        if self._points is not None:
            points = frame.points_m
            points = points_from_depth(camera, frame.depth_m) if points is None else points.reshape(-1, 3)
            self._points.publish(points_message(make, *about, points))
        for publisher, array in ((self._intensity, frame.intensity), (self._confidence, frame.confidence)):
            if array is not None:
                publisher.publish(image_message(make, *about, array, "mono16"))

    def _camera(self, frame: DepthFrame) -> Camera:
        """The intrinsics that go with a frame: those of calibration.yaml, else the device's own."""
        camera = self._calibrated or self._source.camera
        rows, cols = frame.depth_m.shape
        if camera is None:
            raise CalibrationError("the device tells no intrinsics: give a calibration.yaml with an entry 'tof'")
        if (camera.width, camera.height) != (cols, rows):
            raise CalibrationError(
                f"the depth has {cols} x {rows} pixels, its intrinsics are of {camera.width} x {camera.height}: "
                "give the calibration.yaml of this device"
            )
        return camera

    def _report(self) -> None:
        if not isinstance(self._source, LiveTof):
            return
        for name, count in (self._source.counts - self._counted).items():
            self._diagnostics.count(name, count)
            if name == "opened":
                self._say_opened(self._source)
        self._counted = Counter(self._source.counts)
        for name, value in self._source.told.items():
            self._diagnostics.tell(name, value)
        if self._source.problem:
            self._diagnostics.warn(self._source.problem)
        else:
            self._diagnostics.ok()

    def _say_opened(self, source: LiveTof) -> None:
        self.get_logger().info(f"{source.told['device']} is open: {source.camera or 'no intrinsics'}")
        for warning in source.warnings:
            self.get_logger().warning(warning)
        if self._calibrated and source.camera and not self._calibrated.agrees_with(source.camera):
            self.get_logger().warning(f"calibration.yaml is used, {self._calibrated}; the device says {source.camera}")

    def _publisher(self, kind: type, topic: str) -> WatchedPublisher:
        return self._diagnostics.watch(self.create_publisher(kind, topic, image_qos(self._settings)))

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
