"""A stand-in for the graph: answers each image after a while, and says how many it had at once."""

from __future__ import annotations

import collections
import json
import sys
import time
from pathlib import Path

from rclpy.node import Node
from rgbd_dic_acquisition.in_flight import header_stamp_ns
from rgbd_dic_acquisition.messages import header_message
from rgbd_dic_acquisition.nodes.ros_messages import make
from rgbd_dic_acquisition.nodes.spinning import run
from sensor_msgs.msg import Image

from rgbd_dic_msgs.msg import FramePair, PlaneStamped


class AnsweringNode(Node):
    """Answers on `frame_pair` at once and on `plane` after `delay_s`, there not for image number `mute`."""

    def __init__(self, report: Path, delay_s: float, mute: int) -> None:
        super().__init__("answering_node")
        self._report, self._delay_s, self._mute = report, delay_s, mute
        self._waiting: collections.deque[tuple[float, int]] = collections.deque()
        self._received = self._most = 0
        self._pair = self.create_publisher(FramePair, "frame_pair", 100)
        self._plane = self.create_publisher(PlaneStamped, "plane", 100)
        self.create_subscription(Image, "camera/image_raw", self._take, 100, raw=True)

    def work(self):
        while True:
            while self._waiting and self._waiting[0][0] <= time.monotonic():
                header = header_message(make, self._waiting.popleft()[1], "")
                self._plane.publish(make("rgbd_dic_msgs/msg/PlaneStamped", header=header))
            yield 0.002

    def close(self) -> None:
        self._report.write_text(json.dumps({"received": self._received, "most": self._most}))

    def _take(self, data: bytes) -> None:
        stamp_ns = header_stamp_ns(data)
        self._received += 1
        self._pair.publish(make("rgbd_dic_msgs/msg/FramePair", header=header_message(make, stamp_ns, "")))
        if self._received != self._mute:
            self._waiting.append((time.monotonic() + self._delay_s, stamp_ns))
        self._most = max(self._most, len(self._waiting))


if __name__ == "__main__":
    report, delay_s, mute = sys.argv[1:4]
    raise SystemExit(run(lambda: AnsweringNode(Path(report), float(delay_s), int(mute)), sys.argv[4:]))
