"""Stands for the sensors: plays the flight from memory, 60 images a second, stamped with the time of their publishing.

What it costs is little: the messages are made once, and only their stamps change.
"""

from __future__ import annotations

import argparse
import json
import struct
import time
from pathlib import Path

from flight import EVERY, PHASE, RATE_HZ, Flight, depth_index, flight, image_index
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rgbd_dic_acquisition.calibration import load_calibration
from rgbd_dic_acquisition.messages import camera_info_message, image_message, imu_message
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.ros_messages import QosSettings, image_qos, make
from rgbd_dic_acquisition.nodes.spinning import run
from sensor_msgs.msg import CameraInfo, Image, Imu

CAMERA, TOF = "camera_optical_frame", "tof_optical_frame"
IMU_EVERY_S = 0.01


class Source(Node):
    """Waits until `connected` subscriptions hear the images, plays for a while, and writes down what it has sent."""

    def __init__(self, played: Flight, duration_s: float, connected: int, log: Path) -> None:
        super().__init__("source")
        self._duration_s, self._connected, self._log = duration_s, connected, log
        self._diagnostics, qos = Diagnostics(self), image_qos(QosSettings())
        calibration = load_calibration(played.calibration)

        def publisher(kind: type, topic: str) -> Publisher:
            return self._diagnostics.watch(self.create_publisher(kind, topic, qos))

        self._image = publisher(Image, "camera/image_raw")
        self._image_info = publisher(CameraInfo, "camera/camera_info")
        self._depth = publisher(Image, "tof/depth/image_raw")
        self._depth_info = publisher(CameraInfo, "tof/depth/camera_info")
        self._imu = publisher(Imu, "imu/data")
        self._images = [serialize_message(image_message(make, 0, CAMERA, image, "mono8")) for image in played.images]
        self._depths = [serialize_message(image_message(make, 0, TOF, depth, "16UC1")) for depth in played.depths]
        self._infos = [
            serialize_message(camera_info_message(make, 0, frame, camera))
            for frame, camera in ((CAMERA, calibration.camera), (TOF, calibration.tof))
        ]
        self._attitude = serialize_message(imu_message(make, 0, "base_link", (0.0, 0.0, 0.0, 1.0), [0.0] * 9))

    def work(self):
        while self._image.matched < self._connected:
            yield 0.1
        start_s = time.monotonic() + 1.0
        sent: list[tuple[int, int]] = []
        depths, attitudes = 0, 0
        while True:
            due = [
                (len(sent) / RATE_HZ, "image"),
                ((EVERY * depths + PHASE) / RATE_HZ, "depth"),
                (attitudes * IMU_EVERY_S, "imu"),
            ]
            at_s, kind = min(due)
            if at_s >= self._duration_s:
                break
            while (wait_s := start_s + at_s - time.monotonic()) > 0.0005:
                yield wait_s
            stamp_ns = time.time_ns()
            if kind == "image":
                self._image.publish(_stamped(self._images[image_index(len(sent))], stamp_ns))
                self._image_info.publish(_stamped(self._infos[0], stamp_ns))
                sent.append((stamp_ns, image_index(len(sent))))
            elif kind == "depth":
                self._depth.publish(_stamped(self._depths[depth_index(depths)], stamp_ns))
                self._depth_info.publish(_stamped(self._infos[1], stamp_ns))
                depths += 1
            else:
                self._imu.publish(_stamped(self._attitude, stamp_ns))
                attitudes += 1
        self._log.write_text(json.dumps({"sent": sent, "took_s": time.monotonic() - start_s}))
        while True:  # what was sent last is still on its way
            yield 0.2


def _stamped(serialised: bytes, stamp_ns: int) -> bytes:
    """The same message with another stamp: CDR begins with four bytes, then the stamp."""
    return b"".join([serialised[:4], struct.pack("<iI", *divmod(stamp_ns, 1_000_000_000)), memoryview(serialised)[12:]])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flight", type=Path, required=True)
    parser.add_argument("--duration", type=float, required=True)
    parser.add_argument("--connected", type=int, required=True)
    parser.add_argument("--log", type=Path, required=True)
    options = parser.parse_args()
    played = flight(options.flight)
    return run(lambda: Source(played, options.duration, options.connected, options.log), [])


if __name__ == "__main__":
    raise SystemExit(main())
