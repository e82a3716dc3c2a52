"""tof_node as it runs, on a camera behind a GenTL producer and on pylon's emulated one."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fake_blaze import HEIGHT, SERIAL, WIDTH, FakeBlaze, compiler, producer
from rclpy.executors import SingleThreadedExecutor
from rgbd_dic_acquisition.calibration import Calibration, Camera, points_from_depth, save_calibration
from rgbd_dic_acquisition.messages import image_from_message, points_from_message, stamp_to_ns
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, TimeReference
from test_nodes import Processes, _finish, _stop, _wait_for

INSTALL = "is missing: make setup-tof"
TOPICS = {
    "tof/depth/image_raw": Image,
    "tof/depth/camera_info": CameraInfo,
    "tof/intensity/image_raw": Image,
    "tof/confidence/image_raw": Image,
    "tof/points": PointCloud2,
    "tof/time_reference": TimeReference,
}


class Listener:
    """All that tof_node says in the domain of some processes."""

    def __init__(self, processes: Processes) -> None:
        self.messages: dict[str, list[Any]] = defaultdict(list)
        self.statuses: list[DiagnosticStatus] = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=int(processes._environment["ROS_DOMAIN_ID"]))
        self._node = rclpy.create_node("listener", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        for topic, kind in TOPICS.items():
            self._node.create_subscription(kind, topic, self.messages[topic].append, 100)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 100)

    def _take(self, message: DiagnosticArray) -> None:
        self.statuses += [status for status in message.status if status.name == "/tof_node"]

    @property
    def counters(self) -> dict[str, str]:
        return {pair.key: pair.value for pair in self.statuses[-1].values} if self.statuses else {}

    def until(self, condition: Callable[[], bool], seconds: float = 120.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, (self.statuses[-1:], {k: len(v) for k, v in self.messages.items()})
            self._executor.spin_once(timeout_sec=0.05)

    def warned_of(self, text: str) -> bool:
        warnings = [status for status in self.statuses if status.level == DiagnosticStatus.WARN]
        return any(text in status.message for status in warnings)

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture
def processes(tmp_path) -> Iterator[Processes]:
    started = Processes(tmp_path)
    yield started
    started.end()


@pytest.fixture
def listener(processes) -> Iterator[Listener]:
    made = Listener(processes)
    yield made
    made.close()


@pytest.fixture
def blaze(tmp_path, processes) -> FakeBlaze:
    if compiler() is None:
        pytest.skip("no C++ compiler: apt-get install g++")
    pytest.importorskip("harvesters", reason=f"harvesters {INSTALL}")
    (tmp_path / "camera").mkdir()
    made = FakeBlaze(tmp_path / "camera")
    processes._environment |= made.environment
    return made


def test_a_blaze_reaches_the_topics_and_its_faults_do_not_end_the_node(processes, listener, blaze):
    depth = listener.messages["tof/depth/image_raw"]
    node = processes.node("tof_node", source="gentl", tof__producer=str(producer()), publish_points=True)
    listener.until(lambda: len(depth) >= 5)

    # What it sees, with the intrinsics that it tells, and one stamp for all.
    first = {topic: messages[-1] for topic, messages in listener.messages.items()}
    expected_mm = np.rint(blaze.stored * (10000 / 65536))  # 0 is none in both
    np.testing.assert_array_equal(image_from_message(first["tof/depth/image_raw"]), expected_mm)
    np.testing.assert_array_equal(image_from_message(first["tof/intensity/image_raw"]), blaze.intensity)
    confidence = np.where(blaze.stored == 0, 0, blaze.confidence)
    np.testing.assert_array_equal(image_from_message(first["tof/confidence/image_raw"]), confidence)
    camera = Camera.from_camera_info(first["tof/depth/camera_info"])
    assert camera == Camera(WIDTH, HEIGHT, 51.25, 51.25, 31.125, 24.5)
    points = points_from_depth(camera, np.where(blaze.stored == 0, np.nan, blaze.stored * (10 / 65536)))
    cloud = points_from_message(first["tof/points"])
    np.testing.assert_allclose(cloud, points[np.isfinite(points[:, 2])], atol=1e-6)
    assert first["tof/depth/image_raw"].header.frame_id == "tof_optical_frame"
    listener.until(lambda: listener.counters.get("device") == f"fake blaze-101 {SERIAL}")

    # A few buffers fail.
    blaze["fail"] = 4
    listener.until(lambda: listener.warned_of("buffers of the ToF camera fail: the buffer is incomplete"))
    listener.until(lambda: listener.counters["failed"] == "4" and listener.statuses[-1].level == DiagnosticStatus.OK)

    # It is unplugged, and comes back with its clock started anew.
    before = len(depth)
    blaze["present"] = 0
    listener.until(lambda: listener.warned_of("no device is found"))
    blaze["offset_ns"], blaze["present"] = 1_000_000_000, 1
    listener.until(lambda: len(depth) > before + 5 and listener.statuses[-1].level == DiagnosticStatus.OK)
    assert int(listener.counters["reopened"]) >= 1  # more on a computer so busy that the camera itself falls silent

    stamps = {topic: [stamp_to_ns(each.header.stamp) for each in got] for topic, got in listener.messages.items()}
    assert all(np.all(np.diff(each) > 0) for each in stamps.values())
    assert len(set.intersection(*map(set, stamps.values()))) > 5  # not all: a slow listener loses some
    assert "ToF camera runs: Camera(width=64, height=48, fx=51.25" in _stop(node)


def test_the_calibration_that_is_given_is_used_and_a_difference_is_told(processes, listener, blaze, tmp_path):
    mine = Camera(WIDTH, HEIGHT, 52.0, 52.0, 32.0, 24.0, 0.01, 0.0)
    save_calibration(Calibration(Camera(96, 72, 90.0, 90.0, 47.5, 35.5), mine), tmp_path / "calibration.yaml")
    files = {"calibration": str(tmp_path / "calibration.yaml"), "tof__producer": str(producer())}
    node = processes.node("tof_node", source="gentl", **files)
    listener.until(lambda: len(listener.messages["tof/depth/camera_info"]) > 0)
    assert Camera.from_camera_info(listener.messages["tof/depth/camera_info"][0]) == mine
    log = _stop(node)
    assert "calibration.yaml is used" in log and "the ToF camera says Camera(width=64, height=48, fx=51.25" in log


def test_a_calibration_of_another_size_ends_the_node(processes, blaze, tmp_path):
    other = Camera(640, 480, 510.0, 510.0, 319.5, 239.5)
    save_calibration(Calibration(other, other), tmp_path / "calibration.yaml")
    files = {"calibration": str(tmp_path / "calibration.yaml"), "tof__producer": str(producer())}
    log = _finish(processes.node("tof_node", source="gentl", **files), code=1)
    assert "depth of 64 x 48 pixels has intrinsics of 640 x 480" in log


def test_a_setting_that_the_device_refuses_ends_the_node(processes, blaze):
    node = processes.node("tof_node", source="gentl", tof__producer=str(producer()), tof__long_range=False)
    assert "the device refuses DepthMax = 5000 (possible: 0 to 1498)" in _finish(node, code=1)


def test_pylon_is_spoken_to_and_its_failures_are_told(processes, listener):
    """pylon's emulated camera has no range: each of its buffers is told as a failed one."""
    pytest.importorskip("pypylon", reason=f"pypylon {INSTALL}")
    processes._environment["PYLON_CAMEMU"] = "1"
    node = processes.node("tof_node", source="pylon")
    _wait_for(node, "Emulation 0815-0000", 120)
    listener.until(lambda: listener.warned_of("buffers of the ToF camera fail: the frame has no component 'Range'"))
    assert not listener.messages["tof/depth/image_raw"]
    _stop(node)
