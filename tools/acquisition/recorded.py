"""What is in the recording of a session, and whether each frame shows what the peer showed."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from flight_peers import AUTOPILOT, CAMERA, EXPOSURE_S, TOF, sent
from numpy.typing import NDArray
from rendered_flight import DEPTH_STEP_M, RenderedFlight
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.messages import image_from_message, stamp_to_ns
from session import BAG, Flown

MIDDLE_NS = -round(EXPOSURE_S * 1e9 / 2)  # of an exposure, from its end, which is what the camera writes down
FRAME_TOPICS = {
    CAMERA: ("camera/image_raw", "camera/camera_info", "camera/time_reference"),
    TOF: (
        "tof/depth/image_raw",
        "tof/depth/camera_info",
        "tof/intensity/image_raw",
        "tof/confidence/image_raw",
        "tof/time_reference",
    ),
    AUTOPILOT: ("imu/data",),
}


class Recorded:
    """What is in the bag; the content of each frame is compared with what the peer showed.

    Attributes:
        stamps: topic -> stamp -> when it was recorded [ns].
        device_ns: camera or ToF camera -> stamp -> its own time of it [ns].
        attitudes: (stamp, quaternion x, y, z, w).
        said: node -> (when it was recorded, level, message, values) of its statuses.
        other_content: camera or ToF camera -> stamps of frames that were never shown like this.
        openings: how many images of the part that counts had one in flight.
    """

    def __init__(self, folder: Path, flown: Flown, rendered: RenderedFlight) -> None:
        self.stamps: dict[str, dict[int, int]] = defaultdict(dict)
        self.device_ns: dict[str, dict[int, int]] = {CAMERA: {}, TOF: {}}
        self.attitudes: list[tuple[int, NDArray]] = []
        self.said: dict[str, list[tuple[int, int, str, dict[str, str]]]] = defaultdict(list)
        self.other_content: dict[str, list[int]] = {CAMERA: [], TOF: []}
        self.openings = 0
        self._shown = {peer: _by_device_time(sent(folder, peer), peer) for peer in (CAMERA, TOF)}
        self._rendered, self._flown = rendered, flown
        self._waiting: dict[tuple[str, int], NDArray] = {}
        wanted = {f"/{topic}" for topics in FRAME_TOPICS.values() for topic in topics} | {"/diagnostics"}
        with BagReader(folder / BAG) as bag:
            for topic, log_ns, message in bag.messages(sorted(wanted | {"/crack_opening"})):
                self._take(topic.lstrip("/"), log_ns, message)

    def _take(self, topic: str, log_ns: int, message: Any) -> None:
        if topic == "diagnostics":
            for status in message.status:
                values = {pair.key: pair.value for pair in status.values}
                self.said[status.name.lstrip("/")].append((log_ns, int(status.level), status.message, values))
            return
        stamp_ns = stamp_to_ns(message.header.stamp)
        if topic == "crack_opening":
            self.openings += self._flown.begin_ns <= stamp_ns < self._flown.end_ns
            return
        self.stamps[topic][stamp_ns] = log_ns
        if topic == "imu/data":
            q = message.orientation
            self.attitudes.append((stamp_ns, np.array([q.x, q.y, q.z, q.w])))
        peer = TOF if topic.startswith("tof") else CAMERA
        if topic.endswith("time_reference"):
            self.device_ns[peer][stamp_ns] = stamp_to_ns(message.time_ref)
        if topic in ("camera/image_raw", "tof/depth/image_raw"):
            self._waiting[peer, stamp_ns] = image_from_message(message)
        if (peer, stamp_ns) in self._waiting and stamp_ns in self.device_ns.get(peer, {}):
            self._compare(peer, stamp_ns, self._waiting.pop((peer, stamp_ns)))

    def _compare(self, peer: str, stamp_ns: int, pixels: NDArray) -> None:
        """Whether these are the pixels that the peer showed then; whole millimetres of depth, to one where it ties."""
        _, index = self._shown[peer].get(self.device_ns[peer][stamp_ns], (0, -1))
        if index < 0:
            return
        if peer == CAMERA:
            same = np.array_equal(pixels, self._rendered.shown_images[index])
        else:
            stored = self._rendered.shown_depth[index, 0]
            expected = np.rint(stored * (DEPTH_STEP_M * 1e3))
            same = bool(np.all(np.abs(pixels - expected) <= 1) and np.array_equal(pixels == 0, expected == 0))
        if not same:
            self.other_content[peer].append(stamp_ns)

    def shown(self, peer: str, stamp_ns: int) -> tuple[int, int] | None:
        """(Moment, index) of a camera's frame, found by its device time."""
        return self._shown[peer].get(self.device_ns[peer].get(stamp_ns, -1))


def _by_device_time(written: NDArray, peer: str) -> dict[int, tuple[int, int]]:
    """Device time of a stamp -> (moment, index). The camera's stamps are of the middle of the exposure."""
    later_ns = MIDDLE_NS if peer == CAMERA else 0
    return {int(device) + later_ns: (int(host), int(index)) for _, host, device, index in written}
