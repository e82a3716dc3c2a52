"""The greyscale camera: images with their calibration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from ..calibration import load_calibration
from ..errors import RgbdDicError
from ..messages import camera_info_message, image_message
from ..settings import setting
from ..simulator.flight import FlightSettings
from ..simulator.live import SimulatedCamera
from ..sources import CameraSource
from .diagnostics import Diagnostics
from .parameters import declare, declare_path
from .ros_messages import QosSettings, image_qos, make
from .spinning import run

READ_S = 0.02


@dataclass(frozen=True)
class CameraNodeSettings(QosSettings):
    """Where the images come from and how they are sent."""

    source: str = setting("simulated", doc="where the images come from", choices=("simulated",))
    frame_id: str = setting("camera_optical_frame", doc="frame of the images: z forward, x right, y down")


class CameraNode(Node):
    """Publishes `camera/image_raw` (mono8) and, with the same stamp, `camera/camera_info`."""

    def __init__(self) -> None:
        super().__init__("camera_node")
        self._settings = declare(self, CameraNodeSettings)
        flight = declare(self, FlightSettings, "flight")
        calibration = declare_path(self, "calibration", "calibration.yaml in place of the source's own", False)
        self._source: CameraSource = SimulatedCamera(flight, self._say_progress)
        self._done_opening = False
        self._camera = load_calibration(calibration).camera if calibration else self._source.camera
        self._diagnostics = Diagnostics(self)
        qos = image_qos(self._settings)
        self._image = self._diagnostics.watch(self.create_publisher(Image, "camera/image_raw", qos))
        self._info = self._diagnostics.watch(self.create_publisher(CameraInfo, "camera/camera_info", qos))

    def work(self) -> Iterator[float]:
        """Publish frame after frame."""
        yield from self._open()
        self.get_logger().info(f"{self._settings.source} camera runs: {self._camera}")
        while True:
            frame = self._source.read(READ_S)
            if frame is not None:
                about = (frame.stamp_ns, self._settings.frame_id)
                self._image.publish(image_message(make, *about, frame.image, "mono8"))
                self._info.publish(camera_info_message(make, *about, self._camera))
            yield 0.0

    def close(self) -> None:
        self._source.close()

    def _open(self) -> Iterator[float]:
        """Open the source beside the callbacks: it may take seconds, and a node must answer meanwhile."""
        with ThreadPoolExecutor(1) as beside:
            opening = beside.submit(self._source.open)
            try:
                while not opening.done():
                    yield 0.05
            finally:
                self._done_opening = True
        opening.result()

    def _say_progress(self, done: int, total: int) -> None:
        if self._done_opening:
            raise RgbdDicError("ended while the simulated flight was being rendered")
        if done % max(total // 4, 1) == 0:
            self.get_logger().info(f"rendering the simulated flight: {done} of {total} images")


def main(args: Sequence[str] | None = None) -> int:
    return run(CameraNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
