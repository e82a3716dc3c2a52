"""recorder_node, its disk full or itself killed, in a graph that goes on."""

from __future__ import annotations

import itertools
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from graph_ear import GraphEar
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rgbd_dic_acquisition.bag import BagReader, make_message
from rgbd_dic_acquisition.bag_repair import repair_bag
from rgbd_dic_acquisition.message_types import serialise
from rgbd_dic_acquisition.messages import image_message, stamp_to_ns
from rgbd_dic_acquisition.nodes.ros_messages import QosSettings, detail_qos
from sensor_msgs.msg import Image
from small_disks import memory_disk
from test_nodes import Processes

WARN, ERROR = DiagnosticStatus.WARN[0], DiagnosticStatus.ERROR[0]
TOPICS = ["camera/image_raw sensor_msgs/msg/Image"]


@pytest.fixture
def processes(tmp_path):
    started = Processes(tmp_path)
    yield started
    started.end()


class Camera:
    """Publishes images whose stamps count up."""

    def __init__(self, node: Node, rows: int, qos: QoSProfile | int = 100) -> None:
        self._publisher, self.node = node.create_publisher(Image, "camera/image_raw", qos), node
        self._rows, self.sent = rows, 0

    def wait_for_listeners(self, count: int) -> None:
        wait_for(lambda: self._publisher.get_subscription_count() >= count)

    def publish(self) -> None:
        pixels = np.full((self._rows, 400), self.sent % 256, np.uint8)
        self._publisher.publish(serialise(image_message(make_message, self.sent, "camera", pixels, "mono8")))
        self.sent += 1


@contextmanager
def camera(processes: Processes, rows: int = 250, qos: QoSProfile | int = 100) -> Iterator[Camera]:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain(processes))
    node = rclpy.create_node("camera", context=context)
    try:
        yield Camera(node, rows, qos)
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def domain(processes: Processes) -> int:
    return int(processes._environment["ROS_DOMAIN_ID"])


def wait_for(condition, meanwhile=lambda: time.sleep(0.05), seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        meanwhile()


def stamps(path, topic: str = "camera/image_raw") -> list[int]:
    with BagReader(path) as bag:
        return [stamp_to_ns(message.header.stamp) for name, *_, message in bag.messages() if name.endswith(topic)]


def test_a_full_disk_ends_the_bag_and_nothing_else(processes, tmp_path):
    small = {"reserve_mb": 6, "buffer_mb": 16, "topics": TOPICS}
    with memory_disk(tmp_path, 24) as disk, camera(processes) as sensor:
        with GraphEar(domain(processes), "recorder_node", {}) as ear:
            recorder = processes.node("recorder_node", output=str(disk / "flight"), **small)
            other = processes.node(
                "recorder_node", "-r", "__node:=other", output=str(tmp_path / "other"), topics=TOPICS
            )
            sensor.wait_for_listeners(2)

            def image() -> None:
                sensor.publish()
                time.sleep(0.03)

            wait_for(lambda: ear.level == ERROR, image)
            for _ in range(20):
                image()
            before = [(level, text) for _, level, text, _ in ear.said if level != ERROR]
            assert any(level == WARN and "the disk is full in about" in text for level, text in before)
            assert "make room, and start the recorder again with a new output" in ear.message
            wait_for(lambda: int(ear.values.get("dropped /camera/image_raw", 0)) >= 20)
        assert recorder.poll() is None, "it lives on"
        recorder.terminate()
        assert recorder.wait(20) == 1
        assert "disk is full but for 6 MB" in recorder.log.read_text().splitlines()[-1]
        other.terminate()
        assert other.wait(20) == 0
        kept = stamps(disk / "flight")
        assert repair_bag(disk / "flight").path is None, "index and metadata are there"
    assert kept == list(range(len(kept))) and 17e6 < len(kept) * 100_000 < 20.5e6
    assert stamps(tmp_path / "other") == list(range(sensor.sent)), "the others are unharmed"
    assert "dropped" not in other.log.read_text()


def test_what_a_killed_recorder_got_of_a_slow_topic_is_in_its_bag(processes, tmp_path):
    """Small messages, a chunk of which would take long to be full: they are in the file soon all the same."""
    recorder = processes.node("recorder_node", output=str(tmp_path / "flight"), topics=TOPICS)
    copies = itertools.count()
    with camera(processes, rows=1) as sensor:
        sensor.wait_for_listeners(1)
        before_ns = time.time_ns()
        for _ in range(5):
            sensor.publish()

        def is_written() -> bool:
            try:
                return len(stamps(repair_bag(tmp_path / "flight", tmp_path / f"copy_{next(copies)}").path)) == 5
            except Exception:  # nothing is there yet
                return False

        wait_for(is_written)
        recorder.kill()
        recorder.wait()
        after_ns = time.time_ns()
    repaired = repair_bag(tmp_path / "flight").path
    assert stamps(repaired) == list(range(5))
    with BagReader(repaired) as bag:  # log times are those of arrival; the middleware rounds them by a nanosecond
        assert before_ns - 1000 < bag.start_ns < bag.end_ns < after_ns


def test_what_did_not_get_here_is_counted(processes, tmp_path):
    """A recorder that is stopped for a while gets more than its queue holds; what it lost of that, it says."""
    with camera(processes) as sensor, GraphEar(domain(processes), "recorder_node", {}) as ear:
        recorder = processes.node("recorder_node", output=str(tmp_path / "flight"), topics=TOPICS, queue_depth=5)
        sensor.wait_for_listeners(1)
        for _ in range(10):
            sensor.publish()
            time.sleep(0.05)
        wait_for(lambda: int(ear.values.get("recorded /camera/image_raw", 0)) > 0)
        recorder.send_signal(signal.SIGSTOP)
        for _ in range(150):
            sensor.publish()
            time.sleep(0.01)
        recorder.send_signal(signal.SIGCONT)
        for _ in range(10):
            sensor.publish()
            time.sleep(0.1)
        wait_for(lambda: int(ear.values.get("missed /camera/image_raw", 0)) > 0)
        assert any(level == WARN and "did not get here" in text for _, level, text, _ in ear.said)
        time.sleep(1.5)
        missed = int(ear.values["missed /camera/image_raw"])
        recorder.terminate()
        assert recorder.wait(20) == 0
    kept = stamps(tmp_path / "flight")
    assert kept == sorted(kept) and kept[-1] == sensor.sent - 1
    assert missed == kept[-1] + 1 - kept[0] - len(kept)


def test_small_messages_outlast_a_halt(processes, tmp_path):
    """Of the messages that come with each image, none is lost while the recorder stands still for as long as 80 images
    take, which fill what lies between the two; a queue of ten loses most of them."""
    with camera(processes, rows=1, qos=detail_qos(QosSettings())) as details:
        images = details.node.create_publisher(Image, "camera/large", 10)
        topics = [*TOPICS, "camera/large sensor_msgs/msg/Image"]
        recorder = processes.node("recorder_node", output=str(tmp_path / "flight"), topics=topics)
        details.wait_for_listeners(1)
        wait_for(lambda: images.get_subscription_count() == 1)
        image = serialise(image_message(make_message, 0, "camera", np.zeros((1080, 1440), np.uint8), "mono8"))
        details.publish()
        time.sleep(1.0)
        recorder.send_signal(signal.SIGSTOP)
        for _ in range(80):
            images.publish(image)
            details.publish()
        recorder.send_signal(signal.SIGCONT)
        time.sleep(3.0)
        recorder.terminate()
        assert recorder.wait(20) == 0
    assert stamps(tmp_path / "flight") == list(range(81))
