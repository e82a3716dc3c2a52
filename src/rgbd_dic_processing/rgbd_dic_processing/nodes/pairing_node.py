"""pairing_node: tells which ToF frame belongs to each image, and which attitude.

The executor does not serve the attitudes, of which there are more than images: the node takes what has come of them by
itself when it needs one. An event costs several times what an attitude does (docs/live.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rgbd_dic_acquisition.in_flight import header_stamp_ns
from rgbd_dic_acquisition.messages import stamp_to_ns
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.parameters import declare
from rgbd_dic_acquisition.nodes.ros_messages import make
from rgbd_dic_acquisition.nodes.spinning import run
from sensor_msgs.msg import CameraInfo, Imu, PointCloud2

from rgbd_dic_msgs.msg import FramePair as FramePairMessage

from ..core.nearest_attitude import Attitude, NearestAttitude
from ..core.pairing import FramePair, FramePairing
from ..core.settings import PairingSettings
from .inputs import STREAM_DEPTH, IdleFlush, sensor_qos
from .keeping_up import come
from .messages import frame_pair_message


class PairingNode(Node):
    def __init__(self, **options: Any) -> None:
        self._imu: Subscription | None = None
        super().__init__("pairing_node", **options)
        settings = declare(self, PairingSettings, "pairing")
        self._pairing, self._attitudes = FramePairing(settings), NearestAttitude(settings.max_attitude_offset_s)
        self._frame_id = ""
        self.diagnostics = Diagnostics(self)
        self._output = self.diagnostics.watch(self.create_publisher(FramePairMessage, "frame_pair", STREAM_DEPTH))
        self._idle = IdleFlush(self, lambda: self._publish(self._pairing.flush()))
        qos = sensor_qos(self)
        self.create_subscription(CameraInfo, "camera/camera_info", self._image, qos, raw=True)
        self._imu = self.create_subscription(Imu, "imu/data", self._attitude, qos)
        if self.declare_parameter("use_points", False).value:
            self.create_subscription(PointCloud2, "tof/points", self._depth, qos, raw=True)
        else:
            self.create_subscription(CameraInfo, "tof/depth/camera_info", self._depth, qos, raw=True)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Those that the executor serves."""
        return (known for known in super().subscriptions if known is not self._imu)

    def _image(self, serialised: bytes) -> None:
        self._frame_id = self._frame_id or deserialize_message(serialised, CameraInfo).header.frame_id
        self._idle.touch()
        self._publish(self._pairing.add_image(header_stamp_ns(serialised)))

    def _depth(self, serialised: bytes) -> None:
        self._idle.touch()
        self._publish(self._pairing.add_depth(header_stamp_ns(serialised)))

    def _attitude(self, imu: Imu) -> None:
        turn = imu.orientation
        if imu.orientation_covariance[0] >= 0:  # -1: the Imu tells no orientation
            self._attitudes.add(Attitude(stamp_to_ns(imu.header.stamp), (turn.x, turn.y, turn.z, turn.w)))

    def _publish(self, pairs: list[FramePair]) -> None:
        if pairs:
            for imu in come(self._imu):
                self._attitude(imu)
        for pair in pairs:
            if pair.depth_stamp_ns is not None:
                self.diagnostics.count("paired")
                self.diagnostics.ok()
            else:
                self.diagnostics.count("without ToF frame")
                self.diagnostics.warn(pair.reason)
            attitude = self._attitudes.at(pair.stamp_ns)
            self._output.publish(frame_pair_message(make, pair, self._frame_id, attitude))


def main() -> int:
    return run(PairingNode)
