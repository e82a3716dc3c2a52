"""The ToF sensor: depth, intensity and confidence with its calibration."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from ..calibration import Calibration, load_calibration, points_from_depth
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

    source: str = setting("simulated", doc="where the depth frames come from", choices=("simulated",))
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
        path = declare_path(self, "calibration", "calibration.yaml in place of the source's own", False)
        self._source = SimulatedTof(flight)
        calibration = load_calibration(path) if path else self._source.flight.calibration
        if calibration.tof is None:
            raise CalibrationError(f"{path} has no entry 'tof': the depth frames would be uncalibrated")
        self._camera = calibration.tof
        self._diagnostics = Diagnostics(self)
        self._depth = self._publisher(Image, "tof/depth/image_raw")
        self._info = self._publisher(CameraInfo, "tof/depth/camera_info")
        self._intensity = self._publisher(Image, "tof/intensity/image_raw")
        self._confidence = self._publisher(Image, "tof/confidence/image_raw")
        self._points = self._publisher(PointCloud2, "tof/points") if self._settings.publish_points else None
        self._publish_transform(calibration)

    def work(self) -> Iterator[float]:
        """Publish frame after frame."""
        with self._source:
            self.get_logger().info(f"{self._settings.source} ToF sensor runs: {self._camera}")
            while True:
                frame = self._source.read(READ_S)
                if frame is not None:
                    self._publish(frame)
                yield 0.0

    def _publish(self, frame: DepthFrame) -> None:
        about = (frame.stamp_ns, self._settings.frame_id)
        self._depth.publish(depth_message(make, *about, frame.depth_m))
        self._info.publish(camera_info_message(make, *about, self._camera))
        if self._points is not None:
            cloud = points_message(make, *about, points_from_depth(self._camera, frame.depth_m))
            self._points.publish(cloud)
        for publisher, array in ((self._intensity, frame.intensity), (self._confidence, frame.confidence)):
            if array is not None:
                publisher.publish(image_message(make, *about, array, "mono16"))

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
