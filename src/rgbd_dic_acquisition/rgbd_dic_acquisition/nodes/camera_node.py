"""The greyscale camera: images with their calibration."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, TimeReference

from ..calibration import Camera, load_calibration
from ..drivers.aravis_camera import AravisCamera
from ..drivers.aravis_connection import AravisSettings
from ..errors import CalibrationError, RgbdDicError
from ..messages import camera_info_message, header_message, image_message, stamp_message
from ..revival import Revival
from ..settings import setting
from ..simulator.flight import FlightSettings
from ..simulator.live import SimulatedCamera
from ..sources import ImageFrame
from .diagnostics import Diagnostics
from .parameters import declare, declare_path
from .ros_messages import QosSettings, detail_qos, image_qos, make
from .sensor_reading import SensorHealth, read_sensor
from .spinning import run

TIME_REFERENCE = "sensor_msgs/msg/TimeReference"


@dataclass(frozen=True)
class CameraNodeSettings(QosSettings):
    """Where the images come from and how they are sent."""

    source: str = setting("simulated", doc="where the images come from", choices=("simulated", "aravis"))
    frame_id: str = setting("camera_optical_frame", doc="frame of the images: z forward, x right, y down")


class CameraNode(Node):
    """Publishes `camera/image_raw` (mono8) and, with the same stamp, `camera/camera_info`.

    If the camera has a clock of its own, also `camera/time_reference`: host time of the stamp, and the camera's.
    """

    def __init__(self) -> None:
        super().__init__("camera_node")
        self._settings = declare(self, CameraNodeSettings)
        flight = declare(self, FlightSettings, "flight")
        driver = declare(self, AravisSettings, "aravis")
        path = declare_path(self, "calibration", "calibration.yaml; a simulated camera has its own", False)
        calibrated = load_calibration(path).camera if path else None
        self._closing = False
        self._source = self._make_source(flight, driver, calibrated)
        self._camera = calibrated or self._source.camera
        self._revival = Revival(self._source)
        self._diagnostics = Diagnostics(self)
        self._health = SensorHealth(self._diagnostics, self._revival, self._source, self._loss)
        qos, details = image_qos(self._settings), detail_qos(self._settings)
        self._image = self._diagnostics.watch(self.create_publisher(Image, "camera/image_raw", qos))
        self._info = self._diagnostics.watch(self.create_publisher(CameraInfo, "camera/camera_info", details))
        self._time = self._diagnostics.watch(self.create_publisher(TimeReference, "camera/time_reference", details))

    def work(self) -> Iterator[float]:
        """Publish frame after frame."""
        return read_sensor(self._revival, self._health, self._publish, self._say_what_runs)

    def close(self) -> None:
        self._closing = True
        self._revival.close()

    def _make_source(
        self, flight: FlightSettings, driver: AravisSettings, calibrated: Camera | None
    ) -> SimulatedCamera | AravisCamera:
        if self._settings.source == "simulated":
            return SimulatedCamera(flight, self._say_progress)
        if calibrated is None:
            raise CalibrationError(
                "source aravis needs the camera's calibration, which also tells the size of its images: "
                "--ros-args -p calibration:=PATH"
            )
        return AravisCamera(driver, calibrated, self._settings.frame_id)

    def _publish(self, frame: ImageFrame) -> None:
        about = (frame.stamp_ns, self._settings.frame_id)
        self._image.publish(image_message(make, *about, frame.image, "mono8"))
        self._info.publish(camera_info_message(make, *about, self._camera))
        if frame.device_ns is not None:
            header = header_message(make, frame.stamp_ns, "")
            device = stamp_message(make, frame.device_ns)
            self._time.publish(make(TIME_REFERENCE, header=header, time_ref=device, source="camera"))

    def _say_what_runs(self) -> None:
        self.get_logger().info(f"{self._settings.source} camera runs: {self._camera}")

    @staticmethod
    def _loss(new: Counter[str]) -> str:
        lost = new["lost"] or new["incomplete"]
        return "images are lost on the way from the camera: see docs/payload.md, camera" if lost else ""

    def _say_progress(self, done: int, total: int) -> None:
        if self._closing:
            raise RgbdDicError("ended while the simulated flight was being rendered")
        if done % max(total // 4, 1) == 0:
            self.get_logger().info(f"rendering the simulated flight: {done} of {total} images")


def main(args: Sequence[str] | None = None) -> int:
    return run(CameraNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
